"""The kept sums in a file: one compressed .npz of plain arrays and a JSON head, exact to the last bit, nothing executed.

It belongs to one model file, whose SHA-256 it carries.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stopset.artifact import Model
from stopset.errors import ModelFileError
from stopset.files import write_bytes
from stopset.offline.abstraction.metrics import Figures, Repeats
from stopset.offline.abstraction.nominal_part import NominalPart
from stopset.offline.campaign.independence import Ends
from stopset.offline.campaign.noise import NoiseEstimate, RetainedNoise
from stopset.offline.campaign.session import Session
from stopset.offline.campaign.settings import settings_of
from stopset.offline.campaign.survey import Tally
from stopset.offline.conform.bands import Bands
from stopset.offline.conform.envelope import Envelope
from stopset.offline.conform.gather import RetainedSums, SetForm, Sums
from stopset.offline.conform.linear_sets import Gathered
from stopset.offline.conform.zonotopes import Template
from stopset.offline.identify.constants import settings_sha256
from stopset.offline.identify.signals_file import meta_of
from stopset.offline.nominal.normal_equations_file import load_sums as load_nominal
from stopset.offline.nominal.normal_equations_file import sums_bytes
from stopset.recording import Recording, SuiteKey, counted
from stopset.sets import Box
from stopset.types import Array
from stopset.unpacked import check_zip

Arrays = dict[str, NDArray[Any]]
FORMAT = "stopset state"
SCHEMA = 6
REPEATS = {"torque": "repeats", "position": "paths"}  # errors of repeated motions, by kind, and their name here
SIGNALS = ("t", "q", "dq", "tau", "temp", "current", "stop_trigger")
ENVELOPE = ("hi", "lo", "hi_at", "lo_at", "count")


def save_sums(path: str | Path, retained: RetainedSums, model: Model) -> None:
    """Write what is kept of the recordings of ``model``, whole or not at all; ``model`` as saved, with its SHA-256."""
    arrays: Arrays = {}
    head = {
        "format": FORMAT,
        "schema": SCHEMA,
        "model_sha256": model.sha256,
        "settings_sha256": settings_sha256(settings_of(model)),
        "meta": asdict(retained.meta),
        "notes": list(retained.nominal.notes),
        "doubt": retained.nominal.uncertain_torque.tolist(),
        "unseen": retained.nominal.unseen,
        "learnt": sorted(retained.learnt),
        "fitted_files": retained.fitted_files,
        "session": asdict(retained.session),
        "dt": retained.dt,
        "bands": None if retained.form.bands is None else list(retained.form.bands.inner),
        "motion": [[*s, m] for s, m in retained.motion.items()],
        "tally": _pack_tally(retained.tally, arrays),
        "sums": _pack_sums(retained.sums, arrays),
        "stops": [_pack_stop(r, f"stop_{k}", arrays) for k, r in enumerate(retained.stops)],
    }
    if retained.form.bands is not None:
        arrays["reference"] = _edges(retained.form.bands.reference)
    if retained.form.template is not None:
        arrays["generators"], arrays["directions"] = retained.form.template.generators, retained.form.template.directions
    if retained.nominal.data is not None:
        arrays["nominal"] = np.frombuffer(sums_bytes(retained.nominal.data), np.uint8)
    buffer = BytesIO()
    arrays["head"] = np.frombuffer(json.dumps(head).encode(), np.uint8)
    np.savez_compressed(buffer, **arrays)  # type: ignore[arg-type]
    write_bytes(path, buffer.getvalue())


def load_sums(path: str | Path, model: Model) -> RetainedSums:
    """Read what was kept for ``model``.

    Raises `ModelFileError` for a file that is damaged, foreign, of another version or of another model.
    """
    try:
        check_zip(Path(path))
        with np.load(path, allow_pickle=False) as file:
            arrays: Arrays = {name: file[name] for name in file.files}
        head = json.loads(arrays["head"].tobytes())
        if head["format"] != FORMAT:
            raise ValueError(f"format {head['format']!r}")
    except FileNotFoundError as e:
        raise ModelFileError(
            f"{path}: no such file; expected what `stopset identify --keep` wrote: identify again with it"
        ) from e
    except (OSError, EOFError, KeyError, ValueError, TypeError, AttributeError, MemoryError, zipfile.BadZipFile) as e:
        raise ModelFileError(
            f"{path} is damaged or no kept state ({type(e).__name__}); expected what `stopset identify --keep` wrote: identify again"
        ) from e
    if head.get("schema") != SCHEMA:
        raise ModelFileError(f"{path} has schema {head.get('schema')!r}, this stopset reads {SCHEMA}; identify again with --keep")
    if head.get("model_sha256") != model.sha256:
        raise ModelFileError(
            f"{path} belongs to the model {str(head.get('model_sha256'))[:16]}..., not to {model.sha256[:16]}...; give the model it was "
            "kept with"
        )
    if head.get("settings_sha256") != settings_sha256(settings_of(model)):
        raise ModelFileError(
            f"{path} was kept under other settings than the model's, or by a stopset whose algorithm has other constants; identify "
            "again with --keep"
        )
    try:
        return _unpacked(head, arrays, model)
    except (KeyError, ValueError, TypeError, IndexError, AttributeError) as e:
        raise ModelFileError(f"{path} is damaged ({type(e).__name__}: {e}); identify again with --keep") from e


def _unpacked(head: Mapping[str, Any], arrays: Arrays, model: Model) -> RetainedSums:
    data = load_nominal(BytesIO(arrays["nominal"].tobytes()), model.robot.as_described) if "nominal" in arrays else None
    nominal = NominalPart(
        model.robot, model.rotor, model.effects, model.abstraction, tuple(head["notes"]), data, np.array(head["doubt"], float),
        unseen=head["unseen"], inertia_std=model.inertia_std, rotors_shown=model.rotors_shown, taken_out=tuple(model.provenance.get("taken_out", ())),
        friction_covariance=model.provenance.get("friction_covariance", {}),
        left_open=np.array(model.provenance.get("left_open", []), float),
        left_of_own=tuple(model.provenance.get("left_of_own_Nm", ())),
        excess_of_own=tuple(model.provenance.get("excess_of_own", ())),
    )  # fmt: skip
    meta = meta_of(head["meta"])
    dt = float(head["dt"])
    steps = round(settings_of(model).horizon / dt)
    bands = None if head["bands"] is None else Bands(_box(arrays["reference"]), tuple(head["bands"]))
    zonotope = Template(arrays["generators"], arrays["directions"]) if "generators" in arrays else None
    return RetainedSums(
        tally=_tally(head["tally"], arrays), sums=_sums(head["sums"], arrays, nominal, dt, steps, zonotope), nominal=nominal,
        meta=meta, learnt=frozenset(_key(*s) for s in head["learnt"]), session=Session(**head["session"]), dt=dt,
        form=SetForm(bands, zonotope),
        motion={_key(*s): number for *s, number in head["motion"]}, fitted_files=int(head["fitted_files"]),
        stops=_stops(head["stops"], arrays),
    )  # fmt: skip


def _pack_stop(r: Recording, name: str, arrays: Arrays) -> list[Any]:
    given = [field for field in SIGNALS if getattr(r, field) is not None]
    for field in given:
        arrays[f"{name}_{field}"] = getattr(r, field)
    return [r.phase, r.suite, r.trial, r.place, r.file, given]


def _stops(head: list[list[Any]], arrays: Arrays) -> tuple[Recording, ...]:
    def stop(k: int, phase: str, suite: int, trial: int, place: int, file: int, given: list[str]) -> Recording:
        signals: dict[str, Any] = {field: arrays[f"stop_{k}_{field}"] for field in given}
        return Recording(phase, suite, trial, place, file=file, **signals)

    return tuple(counted(stop(k, *row) for k, row in enumerate(head)))


def _key(file: int, phase: str, suite: int, other: int = 0) -> SuiteKey:
    return (file, phase, suite, other)


def _edges(box: Box) -> Array:
    return np.vstack([box.lo, box.hi])


def _box(edges: NDArray[Any]) -> Box:
    return Box(edges[0].copy(), edges[1].copy())


def _pieces(rows: NDArray[Any], lengths: list[int]) -> list[NDArray[Any]]:
    """``rows`` cut into pieces of these lengths; raises `ValueError` if they do not add up."""
    if sum(lengths) != len(rows) or min(lengths, default=0) < 0:
        raise ValueError(f"{len(rows)} rows, {sum(lengths)} expected")
    return [x.copy() for x in np.split(rows, np.cumsum(lengths)[:-1])] if lengths else []


def _pack_tally(tally: Tally, arrays: Arrays) -> dict[str, Any]:
    arrays["torques"] = np.vstack(list(tally.torques.values()))
    arrays["steps"] = np.array(tally.steps)
    if tally.means:
        arrays["means"] = np.array(tally.means)
    for name, box in tally.hulls.items():
        arrays[f"hull_{name}"] = _edges(box)
    noise = tally.noise.retained
    arrays["noise_spread"] = np.vstack([x for rows in noise.spread.values() for x in rows])
    arrays["noise_quantum"] = np.vstack(list(noise.quantum.values()))
    arrays["noise_reach"] = np.vstack(list(noise.reach.values()))
    arrays["noise_late"] = np.stack(list(noise.late.values()))
    return {
        "phase": tally.phase,
        "suites": [[*s, len(x), tally.repeats[s]] for s, x in tally.torques.items()],
        "ends": [[e.t.tolist(), e.q.tolist(), e.dq.tolist()] for e in tally.ends.values()],
        "noise": [[*s, len(rows)] for s, rows in noise.spread.items()],
        "powered": [list(s) for s in noise.reach],
        "hulls": list(tally.hulls),
        "places": tally.places,
        "samples": tally.samples,
        "longest": tally.longest,
        "irregular": tally.irregular,
        "conditions": sorted(tally.conditions),
    }


def _tally(head: Mapping[str, Any], arrays: Arrays) -> Tally:
    suites = [_key(*s) for *s, _, _ in head["suites"]]
    torques = _pieces(arrays["torques"], [length for *_, length, _ in head["suites"]])
    noisy = [_key(*s) for *s, _ in head["noise"]]
    powered = [_key(*s) for s in head["powered"]]
    spread = _pieces(arrays["noise_spread"], [count for *_, count in head["noise"]])
    return Tally(
        phase=head["phase"], torques=dict(zip(suites, torques, strict=True)),
        ends={s: Ends(*map(np.array, e)) for s, e in zip(suites, head["ends"], strict=True)},
        repeats={_key(*s): count for *s, _, count in head["suites"]}, steps=arrays["steps"].tolist(),
        means=list(arrays["means"]) if "means" in arrays else [],
        hulls={name: _box(arrays[f"hull_{name}"]) for name in head["hulls"]},
        noise=NoiseEstimate(
            RetainedNoise(
                {s: list(x) for s, x in zip(noisy, spread, strict=True)},
                *(
                    dict(zip(suites, arrays[f"noise_{name}"], strict=True))
                    for name, suites in (("quantum", noisy), ("reach", powered), ("late", powered))
                ),
            )
        ),
        places=head["places"], samples=head["samples"], longest=head["longest"], irregular=head["irregular"],
        conditions=set(head["conditions"]),
    )  # fmt: skip


def _pack_sums(sums: Sums, arrays: Arrays) -> dict[str, Any]:
    rows, repeats, u = sums.figures.rows()
    assert u is not None
    arrays["figure_rows"] = np.vstack([x for _, x in rows])
    for kind, name in REPEATS.items():
        errors = [e for trials in repeats[kind].values() for _, e in trials]
        arrays[name] = np.vstack(errors) if errors else np.zeros((0, u.dim))
    arrays["hull_u"] = _edges(u)
    return {
        "gathered": _pack_gathered(sums.gathered, arrays),
        "figures": [key for key, _ in rows],
    } | {
        name: [[*s, [[place, len(e)] for place, e in trials]] for s, trials in repeats[kind].items()]
        for kind, name in REPEATS.items()
    }


def _pack_gathered(g: Gathered, arrays: Arrays) -> dict[str, Any]:
    return {
        "parts": [[m, _pack(env, f"part_{m}", arrays)] for m, env in g.parts.items()],
        "start": _pack(g.start, "start", arrays),
        "halves": [_pack(env, f"half_{k}", arrays) for k, env in enumerate(g.halves)],
        "bands": [[k, [[m, _pack(env, f"band_{k}_{m}", arrays)] for m, env in of.items()]] for k, of in g.bands.items()],
    }


def _pack(env: Envelope, name: str, arrays: Arrays) -> list[str]:
    """Put an envelope into ``arrays`` up to the last age reached; its labels go into the head."""
    last = env.steps if env.count.any() else 0
    for field in ENVELOPE:
        arrays[f"{name}_{field}"] = getattr(env, field)[: last + 1]
    return list(env.labels)


def _sums(
    head: Mapping[str, Any], arrays: Arrays, nominal: NominalPart, dt: float, steps: int, zonotope: Template | None
) -> Sums:
    n = nominal.abstraction.n
    across = n if zonotope is None else len(zonotope.directions)

    def envelope(name: str, labels: list[str], k: int = across) -> Envelope:
        x = {field: arrays[f"{name}_{field}"] for field in ENVELOPE}
        rows = len(x["count"])
        for field, shape in zip(ENVELOPE, ((rows, 2 * k),) * 2 + ((rows, 2 * k, 2),) * 2 + ((rows,),), strict=True):
            if x[field].shape != shape:
                raise ValueError(f"{name}: {field} has shape {x[field].shape}, expected {shape}")
        return Envelope(dt, x["hi"], x["lo"], x["hi_at"], x["lo_at"], x["count"], labels).upto(steps)

    g = head["gathered"]
    first, second = (envelope(f"half_{k}", labels) for k, labels in enumerate(g["halves"]))
    gathered = Gathered(
        {m: envelope(f"part_{m}", labels) for m, labels in g["parts"]}, envelope("start", g["start"], n), (first, second),
        {k: {m: envelope(f"band_{k}_{m}", labels) for m, labels in of} for k, of in g["bands"]},
    )  # fmt: skip
    rows = list(zip(head["figures"], arrays["figure_rows"], strict=True))
    repeats = {kind: _repeats(head[name], arrays[name]) for kind, name in REPEATS.items()}
    return Sums(gathered, Figures.of(nominal.abstraction, dt, rows, repeats, _box(arrays["hull_u"])))


def _repeats(listed: Sequence[Any], errors: Array) -> Repeats:
    pieces = iter(_pieces(errors, [length for *_, trials in listed for _, length in trials]))
    return {_key(*s): [(place, next(pieces)) for place, _ in trials] for *s, trials in listed}
