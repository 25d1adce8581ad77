"""A model file becomes an FMU: sources, binaries, description, reference results, in one reproducible archive."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Mapping, Sequence
from io import BytesIO
from pathlib import Path

from stopset.artifact import Model
from stopset.errors import NotCovered, OutputError
from stopset.files import writable, write_bytes
from stopset.fmu.build import PLATFORMS, binaries, chosen, universal
from stopset.fmu.description import NOTICE, build_description, description
from stopset.fmu.sources import UNITS, sources
from stopset.fmu.variables import variables

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


def archive(model: Model, fmi: int = 3, platforms: Sequence[str] | None = None) -> bytes:
    """The FMU's bytes; see `export`."""
    if fmi not in (2, 3):
        raise OutputError(f"FMI version {fmi}; expected 2 or 3")
    if model.abstraction.kind != 1:
        raise NotCovered(f"this is a model {model.abstraction.kind}; the FMU covers model 1 (eq. 13): identify with --model 1")
    targets = chosen(platforms)
    name = identifier(model)
    v = variables(model)
    text, token = sources(model, v)
    units = [*UNITS, "model_data.c"]
    made = binaries(text, units, targets, name)
    files: dict[str, bytes] = {"modelDescription.xml": description(model, v, name, token, fmi, units).encode()}
    files |= _folders(made, fmi, name)
    files |= {f"sources/{file}": content.encode() for file, content in text.items()}
    if fmi == 3:
        files["sources/buildDescription.xml"] = build_description(name, units).encode()
    files["documentation/licenses/license.txt" if fmi == 3 else "documentation/license.txt"] = _licence().encode()
    files["documentation/index.html"] = _documentation(model).encode()
    buffer = BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as z:
        for path, content in files.items():
            info = zipfile.ZipInfo(path, EPOCH)
            info.compress_type = zipfile.ZIP_DEFLATED
            info.external_attr = (0o755 if path.startswith("binaries/") else 0o644) << 16
            z.writestr(info, content)
    return buffer.getvalue()


def export(model: Model, path: str | Path, fmi: int = 3, platforms: Sequence[str] | None = None) -> Path:
    """Write the model as an FMU that needs no Python where it runs.

    ``fmi``: 2 or 3, co-simulation and model exchange both; ``platforms``: names of `PLATFORMS`, all five if left out.
    Raises `OutputError` where nothing can be written, `NotCovered` for a model the FMU cannot carry.
    """
    target = writable(path)
    write_bytes(target, archive(model, fmi, platforms))
    return target


def _licence() -> str:
    return (
        "Written by stopset, Apache-2.0 (https://www.apache.org/licenses/LICENSE-2.0).\n"
        "The FMI headers in sources/ are by the Modelica Association, 2-Clause BSD; each holds its licence.\n"
    )


def _documentation(model: Model) -> str:
    return (
        "<!DOCTYPE html><html><head><meta charset='utf-8'><title>stopset FMU</title></head><body>"
        f"<h1>{model.robot.name}</h1><p>{NOTICE}</p><p>Model file SHA-256: {model.sha256 or 'not saved'}</p>"
        f"<p>{model.guarantee.text}</p></body></html>\n"
    )
