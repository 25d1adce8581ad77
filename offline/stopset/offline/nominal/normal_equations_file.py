"""The sums of a campaign in a file, so that later recordings are folded in without the old ones (``identify --update``)."""

from __future__ import annotations

import json
import zipfile
from dataclasses import asdict
from io import BytesIO
from pathlib import Path

import numpy as np

from stopset.errors import ModelFileError
from stopset.offline.nominal.normal_equations import DELAYS, NormalEquations, empty, layout_of
from stopset.offline.nominal.preprocess import Preprocessing
from stopset.robot import Robot
from stopset.unpacked import check_zip

SCHEMA = 2  # 1: without reversals
ARRAYS = ("rows_moving", "rows_still", "speed", "load", "span", "reference")


def sums_bytes(data: NormalEquations) -> bytes:
    """The sums as a file's content; exact: what is read back equals what was written to the last bit."""
    upper = np.triu_indices(data.moving.shape[-1])
    used = np.flatnonzero(data.rows_moving.sum(axis=1) > 0)
    head = {
        "schema": SCHEMA,
        "joints": list(data.layout.joints),
        "effects": [[c.effect.name for c in columns] for columns in data.layout.columns],
        "parameters": list(data.layout.names()),
        "settings": asdict(data.settings),
        "delays": DELAYS.tolist(),
        "compensated": data.compensated,
        "period": data.period if np.isfinite(data.period) else None,
        "samples": data.samples,
        "recordings": data.recordings,
        "poses": data.poses,
        "skipped": data.skipped,
    }
    buffer = BytesIO()
    np.savez_compressed(
        buffer,
        head=np.frombuffer(json.dumps(head).encode(), np.uint8),
        used=used,
        moving=data.moving[used][..., upper[0], upper[1]],
        still=data.still[..., upper[0], upper[1]],
        **{name: getattr(data, name) for name in ARRAYS},
    )
    return buffer.getvalue()


def load_sums(path: str | Path | BytesIO, robot: Robot) -> NormalEquations:
    """Read sums back for ``robot``; add those of new recordings and solve.

    Raises `ModelFileError` for a file that is damaged, of another version, or of another robot.
    """
    try:
        check_zip(path if isinstance(path, BytesIO) else Path(path))
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        head = json.loads(arrays["head"].tobytes())
        _check(head, robot, path)
        effects = [f"{e}:{j}" for j, es in zip(head["joints"], head["effects"], strict=True) for e in dict.fromkeys(es)]
        layout = layout_of(robot, effects, compensated=head["compensated"])
        if list(layout.names()) != head["parameters"]:
            raise ModelFileError(f"{path}: its effects have other parameters than today's; identify from the recordings again")
        out = empty(robot, layout, Preprocessing(**head["settings"]), arrays["reference"], compensated=head["compensated"])
        c = out.moving.shape[-1]
        moving, still = (_square(arrays[x], c, head["schema"]) for x in ("moving", "still"))
        out.moving[arrays["used"]] = moving
        out.still[:] = still
        for name in ARRAYS:
            if arrays[name].shape != getattr(out, name).shape:
                raise ModelFileError(f"{path}: {name} has shape {arrays[name].shape}; the file is damaged: identify again")
            setattr(out, name, arrays[name])
    except ModelFileError:
        raise
    except (OSError, EOFError, KeyError, ValueError, TypeError, IndexError, MemoryError, zipfile.BadZipFile) as e:
        raise ModelFileError(f"{path} holds no sums of an identification ({type(e).__name__}: {e}); identify again") from e
    out.period = float("nan") if head["period"] is None else float(head["period"])
    out.samples, out.recordings, out.poses = int(head["samples"]), int(head["recordings"]), int(head["poses"])
    out.skipped = {str(k): int(v) for k, v in head["skipped"].items()}
    return out


def _check(head: dict[str, object], robot: Robot, path: str | Path | BytesIO) -> None:
    if head["schema"] not in (1, SCHEMA) or head["delays"] != DELAYS.tolist():
        raise ModelFileError(f"{path} is of version {head['schema']}, expected {SCHEMA}; identify from the recordings again")
    if head["joints"] != list(robot.joints):
        raise ModelFileError(
            f"{path} belongs to joints {head['joints']}, the robot has {', '.join(robot.joints)}; give the robot it was made with"
        )


def _square(upper: np.ndarray, c: int, schema: int) -> np.ndarray:
    """(..., c, c) symmetric matrices from their upper triangles; sums of before reversals were summed are those of motions without any."""
    reversals = c - 1 - len(DELAYS)
    stored = np.arange(c) if schema == SCHEMA else np.delete(np.arange(c), reversals)
    rows, columns = (stored[k] for k in np.triu_indices(len(stored)))
    if upper.shape[-1] != len(rows):
        raise ValueError(f"{upper.shape[-1]} sums, {len(rows)} expected")
    out = np.zeros((*upper.shape[:-1], c, c))
    out[..., rows, columns] = upper
    out[..., columns, rows] = upper
    return out
