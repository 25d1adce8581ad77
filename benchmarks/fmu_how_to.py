"""Make the pictures of docs/how-to/fmu.md with the programs on that page.

Run: python benchmarks/fmu_how_to.py FOLDER docs/pictures, where FOLDER holds arm.fmu (FMI 3) and arm2.fmu (FMI 2) of the demonstration
"""

from __future__ import annotations

import ctypes
import os
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from test_fmu_how_to import programs


def main() -> None:
    """Run every program and label what it drew."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    folder, target = Path(sys.argv[1]), Path(sys.argv[2]).resolve()
    ctypes.CDLL(str(next(Path(sys.prefix).glob("lib/libtbb.so.12"))), mode=ctypes.RTLD_GLOBAL)  # Ecos looks for it
    os.chdir(folder)
    for title in ("fmpy", "Ecos", "libcosim"):
        plt.figure(figsize=(6.0, 3.0), layout="constrained")
        exec(compile(programs()[title], title, "exec"), {})
        axes = plt.gca()
        axes.axvline(0.2, color="#8d99a3", linewidth=1)
        axes.set(xlabel="time [s]", ylabel="first joint [rad]", title=f"{title}: STOP 0 asked for at 0.2 s, dashed the bound")
        rest, bound = (float(line.get_ydata()[-1]) for line in axes.lines[:2])
        plt.savefig(target / f"fmu-{title.lower()}.png", dpi=110)
        print(f"{title}: at rest at {rest:.6f} rad, bound {bound:.6f} rad")


if __name__ == "__main__":
    main()
