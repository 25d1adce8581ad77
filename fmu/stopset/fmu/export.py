"""A model file becomes an FMU: sources, binaries, description, reference results, in one reproducible archive."""

from __future__ import annotations

import hashlib
import json
import re
import tempfile
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np

from stopset.artifact import Model
from stopset.artifact.signature import ORIGIN, revision_of
from stopset.errors import NotCovered, OutputError
from stopset.files import writable, write_bytes
from stopset.fmu.build import PLATFORMS, binaries, chosen, universal
from stopset.fmu.card import card
from stopset.fmu.check import SUMS
from stopset.fmu.description import build_description, description
from stopset.fmu.reference import reference_texts
from stopset.fmu.sources import UNITS, sources
from stopset.fmu.terminals import icon, terminals
from stopset.fmu.variables import variables
from stopset.progress import Progress, silent
from stopset.reach.stops.path import Path as StopPath

EPOCH = (1980, 1, 1, 0, 0, 0)  # the zip format's earliest time: the same model gives the same bytes


def identifier(model: Model) -> str:
    """The model identifier: a C name, also the binaries' file name."""
    return "stopset_" + re.sub(r"\W", "_", model.robot.name, flags=re.ASCII)


def _folders(made: Mapping[str, bytes], fmi: int, name: str) -> dict[str, bytes]:
    """Archive path -> library."""
    if fmi == 3:
        return {f"binaries/{p}/{name}{PLATFORMS[p].suffix}": code for p, code in made.items()}
    out = {f"binaries/{PLATFORMS[p].fmi2}/{name}{PLATFORMS[p].suffix}": code for p, code in made.items() if "darwin" not in p}
    mac = {p: code for p, code in made.items() if "darwin" in p}
    if mac:
        out[f"binaries/darwin64/{name}.dylib"] = universal(mac)
    return out


@dataclass(frozen=True, slots=True)
class Contents:
    """What a unit holds: FMI ``fmi`` (2 or 3), libraries for ``platforms`` (all where empty; none with ``source_only``), reference
    results, of FMI 3 the ``clocks`` that ask for a stop: some importers end when they read of any, and the ``path`` along which stops
    are bounded."""

    fmi: int = 3
    platforms: Sequence[str] = ()
    source_only: bool = False
    reference: bool = True
    clocks: bool = False
    path: StopPath | None = None


ALL = Contents()


def archive(model: Model, contents: Contents = ALL, say: Progress = silent) -> bytes:
    """The FMU's bytes; see `export`."""
    fmi = contents.fmi
    if fmi not in (2, 3):
        raise OutputError(f"FMI version {fmi}; expected 2 or 3: choose one of them")
    if contents.source_only and contents.platforms:
        raise OutputError(f"sources alone and a library for {', '.join(contents.platforms)}; expected one of both: leave one out")
    n = model.n
    if any(np.any(p.exponent[:, 3 * n :].sum(axis=1) > 1) for p in model.abstraction.acceleration):
        raise NotCovered(
            "this is a model 3 whose acceleration is not a straight line over torque; expected one, as identification makes it: "
            "identify again"
        )
    targets = [] if contents.source_only else chosen(contents.platforms)
    name = identifier(model)
    if contents.clocks and fmi != 3:
        raise OutputError("clocks in FMI 2; expected FMI 3, which has them: leave clocks or the version out")
    v = variables(model, clocks=contents.clocks, path=contents.path)
    text, token = sources(model, v)
    units = [*UNITS, "model_data.c"]
    made = binaries(text, units, targets, name, say)
    files: dict[str, bytes] = {"modelDescription.xml": description(model, v, name, token, fmi, units).encode()}
    files |= _folders(made, fmi, name)
    files |= {f"sources/{file}": content.encode() for file, content in text.items()}
    # of FMI 3, and taken back into FMI 2.0.4 as they are
    files["terminalsAndIcons/terminalsAndIcons.xml"] = terminals(v).encode()
    files["terminalsAndIcons/icon.png"] = icon()
    files["sources/buildDescription.xml"] = build_description(name, units).encode()
    if fmi == 2:
        files["model.png"] = icon()
    files["documentation/licenses/license.txt" if fmi == 3 else "documentation/license.txt"] = _licence().encode()
    said = {"robot": model.robot.name, "model_sha256": model.sha256, "revision": revision_of(model)}
    files[ORIGIN] = (json.dumps(said, indent=1) + "\n").encode()
    files["documentation/index.html"] = card(model, v.categories).encode()
    if contents.reference:
        files |= {f"documentation/{file}": content.encode() for file, content in reference_texts(model).files(name).items()}
        say("reference results: computed")
    files[SUMS] = "".join(f"{hashlib.sha256(files[path]).hexdigest()}  {path}\n" for path in sorted(files)).encode()
    buffer = BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as z:
        for path, content in files.items():
            info = zipfile.ZipInfo(path, EPOCH)
            info.compress_type = zipfile.ZIP_DEFLATED
            info.external_attr = (0o755 if path.startswith("binaries/") else 0o644) << 16
            z.writestr(info, content)
    return buffer.getvalue()


def export(model: Model, path: str | Path, contents: Contents = ALL, say: Progress = silent) -> Path:
    """Write the model as an FMU that needs no Python where it runs, co-simulation and model exchange both.

    ``say``: told how far it is.  Raises `OutputError` where nothing can be written, or where fmpy's validator finds
    fault, `NotCovered` for a model the FMU cannot carry.
    """
    target = writable(path)
    unit = archive(model, contents, say)
    problems = validated(unit)
    if problems:
        raise OutputError(f"the unit does not pass fmpy's validator ({problems[0]}); expected no problem: please report this")
    say("fmpy's validator: clean")
    write_bytes(target, unit)
    return target


def validated(unit: bytes) -> list[str]:
    """What fmpy's validator says of an FMU's bytes: nothing where it is clean."""
    from fmpy.validation import validate_fmu  # heavy

    with tempfile.TemporaryDirectory(prefix="stopset-fmu-") as folder:
        path = Path(folder) / "F.fmu"
        path.write_bytes(unit)
        return [str(p) for p in validate_fmu(str(path))]


def _licence() -> str:
    return (
        "Written by stopset, Apache-2.0 (https://www.apache.org/licenses/LICENSE-2.0).\n"
        "The FMI headers in sources/ are by the Modelica Association, 2-Clause BSD; each holds its licence.\n"
    )
