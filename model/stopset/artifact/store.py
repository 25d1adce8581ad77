"""Save and load the model file: one readable JSON object with a schema version and the SHA-256 of its content.

A damaged, foreign or too new file is refused with a sentence that says why; nothing in it is ever executed.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import types
import typing
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any, get_args, get_origin

import numpy as np

from stopset.artifact.contents import check_contents
from stopset.artifact.model import SCHEMA_VERSION, Model
from stopset.errors import ModelFileError, RobotError
from stopset.files import write_text
from stopset.robot import Robot
from stopset.robot.arm import Arm, robot_of
from stopset.sets import Box

FORMAT = "stopset model"
FIRST_SCHEMA, LAGS, ARM = (
    1,
    3,
    5,
)  # since then: files; brakes with lags; the arm itself, before which its description was read each time

Reader = Callable[[str, Mapping[str, Any]], Arm]  # of the description (URDF, data sheet) in a file older than `ARM`


def _key(f: dataclasses.Field[Any]) -> str:
    """What the file calls a field: its name, or the one it had when the format was fixed."""
    return str(f.metadata.get("key", f.name))


def _plain(x: Any) -> Any:
    """Dataclasses, arrays, boxes and tuples to JSON values; infinities as strings, since JSON has none."""
    if isinstance(x, Robot):
        said = {"urdf": x.urdf, "datasheet": dict(x.datasheet), "arm": _plain(x.arm)}
        return {**said, "pi": _plain(x.pi), "gravity": _plain(x.chain.gravity)}
    if isinstance(x, Box):
        return [[_plain(a), _plain(b)] for a, b in zip(x.lo.tolist(), x.hi.tolist(), strict=True)]
    if dataclasses.is_dataclass(x) and not isinstance(x, type):
        return {_key(f): _plain(getattr(x, f.name)) for f in dataclasses.fields(x)}
    if isinstance(x, np.ndarray):
        return _plain(x.tolist())
    if isinstance(x, Mapping):
        return {str(k): _plain(v) for k, v in x.items()}
    if isinstance(x, (list, tuple)):
        return [_plain(v) for v in x]
    if isinstance(x, np.generic):
        return _plain(x.item())
    if isinstance(x, float) and not math.isfinite(x):
        return str(x)
    return x


def _text(body: Mapping[str, Any]) -> str:
    """JSON, one line per leaf list, so that a diff shows what changed."""

    def write(x: Any, pad: str) -> str:
        if isinstance(x, Mapping) and x:
            inner = ",\n".join(f"{pad}  {json.dumps(k)}: {write(v, pad + '  ')}" for k, v in x.items())
            return "{\n" + inner + "\n" + pad + "}"
        if isinstance(x, list) and any(isinstance(v, (list, Mapping)) for v in x):
            return "[\n" + ",\n".join(pad + "  " + write(v, pad + "  ") for v in x) + "\n" + pad + "]"
        return json.dumps(x, ensure_ascii=False)

    return write(body, "") + "\n"


def _digest(body: Mapping[str, Any]) -> str:
    content = {k: v for k, v in body.items() if k != "sha256"}
    return hashlib.sha256(json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=False).encode()).hexdigest()


def model_text(model: Model) -> str:
    """The model file's text; its ``sha256`` covers everything else in it."""
    body: dict[str, Any] = {"format": FORMAT, "schema": SCHEMA_VERSION, "units": "SI: rad, rad/s, N m, s, kg, m, degC"}
    body |= {k: v for k, v in _plain(model).items() if k != "sha256"}
    body["sha256"] = _digest(body)
    return _text(body)


def save_model(model: Model, path: str | Path) -> Model:
    """Write ``model`` to ``path``, whole or not at all; returns it with its hash."""
    text = model_text(model)
    write_text(path, text)
    return dataclasses.replace(model, sha256=json.loads(text)["sha256"])


@cache
def _hints(kind: Any) -> dict[str, Any]:
    """Of a few kinds, asked for thousands of times in a file."""
    return typing.get_type_hints(kind)


def _whole(kind: Any) -> bool:
    """Whether arrays of type ``kind`` hold whole numbers. Up to numpy 2.2 an array's shape is `int` too: only its scalar counts."""
    return any((isinstance(a, type) and issubclass(a, np.integer)) or _whole(a) for a in get_args(kind))


def _build(kind: Any, x: Any, where: str) -> Any:
    """The value of type ``kind`` from JSON ``x``; raises with the place in the file."""
    # numpy's name of an array is an alias of its own since 2.5, of which Python tells the origin only when asked again
    origin = get_origin(getattr(get_origin(kind), "__value__", kind))
    if origin in (typing.Union, types.UnionType):
        options = [a for a in get_args(kind) if a is not type(None)]
        return None if x is None else _build(options[0], x, where)
    if kind is Robot:
        robot = robot_of(_build(Arm, x["arm"], f"{where}.arm"), x["urdf"], x["datasheet"])
        robot = dataclasses.replace(robot, chain=robot.chain._replace(gravity=np.array(x["gravity"], float)))
        return robot.with_parameters(np.array(x["pi"], float))
    if kind is Box:
        rows = np.array([[float(a), float(b)] for a, b in x]).reshape(-1, 2)
        return Box(rows[:, 0].copy(), rows[:, 1].copy())
    if dataclasses.is_dataclass(kind):
        hints = _hints(typing.cast("Any", kind))
        known = {_key(f): f.name for f in dataclasses.fields(kind)}
        if not isinstance(x, Mapping) or set(x) - known.keys():
            raise ValueError(f"{where} holds {sorted(set(x) - known.keys()) if isinstance(x, Mapping) else type(x).__name__}")
        return kind(**{known[k]: _build(hints[known[k]], v, f"{where}.{k}") for k, v in x.items()})  # type: ignore[operator]
    if origin is tuple:
        inner = get_args(kind)
        if len(inner) == 2 and inner[1] is Ellipsis:
            return tuple(_build(inner[0], v, f"{where}[{i}]") for i, v in enumerate(x))
        return tuple(_build(k, v, where) for k, v in zip(inner, x, strict=True))
    if origin in (Mapping, dict) or (isinstance(origin, type) and issubclass(origin, Mapping)):
        value = get_args(kind)[1]
        return {k: _build(value, v, f"{where}.{k}") for k, v in x.items()}
    if origin is np.ndarray:
        return np.array(x, dtype=np.int64 if _whole(kind) else np.float64)
    if kind is float:
        return float(x)
    if kind in (int, str, bool) and not isinstance(x, kind):
        raise ValueError(f"{where} is {x!r}, expected {kind.__name__}")
    return x


def load_model(path: str | Path, reader: Reader | None = None) -> Model:
    """Read a model file, checked: format, schema version, hash, shapes. Raises `ModelFileError` with one sentence.

    ``reader``: for files of older versions, which hold a description and not the arm; without one they are refused.
    """
    return model_of(read_model_text(path), path, reader)


def read_model_text(path: str | Path) -> bytes:
    """The bytes of a model file. Raises `ModelFileError`."""
    p = Path(path)
    try:
        return p.read_bytes()
    except FileNotFoundError as e:
        raise ModelFileError(f"{p}: no such file; expected a model file: run `stopset identify` first") from e
    except OSError as e:
        raise ModelFileError(
            f"{p} cannot be read as a model file ({type(e).__name__}); expected JSON from `stopset identify`"
        ) from e


def model_of(data: bytes, path: str | Path, reader: Reader | None = None) -> Model:
    """The model in the bytes of a file, checked and read as `load_model` says; ``path`` is what refusals name."""
    p = Path(path)
    try:
        body = json.loads(data.decode("utf-8"))
    except UnicodeDecodeError as e:
        raise ModelFileError(
            f"{p} cannot be read as a model file ({type(e).__name__}); expected JSON from `stopset identify`"
        ) from e
    except json.JSONDecodeError as e:
        raise ModelFileError(f"{p} is damaged: not JSON at line {e.lineno}; restore it or identify again") from e
    except RecursionError as e:
        raise ModelFileError(f"{p} is not a stopset model file: its JSON is nested without end; give the right file") from e
    except ValueError as e:  # a number of more digits than Python takes
        raise ModelFileError(f"{p} is not a stopset model file ({e}); give the right file") from e
    if not isinstance(body, dict) or body.get("format") != FORMAT:
        raise ModelFileError(f'{p} is not a stopset model file; expected JSON with "format": "{FORMAT}"')
    if body.get("schema") not in range(FIRST_SCHEMA, SCHEMA_VERSION + 1):
        raise ModelFileError(
            f"{p} has schema {body.get('schema')!r}, this stopset reads {FIRST_SCHEMA} to {SCHEMA_VERSION}; identify again or "
            "match versions"
        )
    try:
        whole = body.get("sha256") == _digest(body)
    except UnicodeEncodeError:  # half a character, which nothing that writes model files leaves
        whole = False
    if not whole:
        raise ModelFileError(f"{p} is damaged: its content does not match its SHA-256; restore it or identify again")
    content = {k: v for k, v in body.items() if k not in ("format", "schema", "units")}
    if body["schema"] < ARM and reader is None:
        raise ModelFileError(
            f"{p} has schema {body['schema']}, which holds the robot's description unread; expected schema {ARM} or later, which holds "
            f"the arm itself: make one of it with `stopset renew {p} --out NEW.model.json` where the offline part is installed"
        )
    try:
        if body["schema"] < ARM and reader is not None:
            content["robot"]["arm"] = _plain(reader(content["robot"]["urdf"], content["robot"]["datasheet"]))
        if body["schema"] < LAGS:
            _own_places(content.get("brakes"))
        model = _build(Model, content, "model")
    except (ValueError, TypeError, KeyError, IndexError, AttributeError, OverflowError, RobotError) as e:
        raise ModelFileError(f"{p} cannot be used ({type(e).__name__}: {e}); identify again") from e
    assert isinstance(model, Model)
    check_contents(model, p)
    return model


def _own_places(brakes: Any) -> None:
    """Brakes of an older file: there a stop's delays lay at the same place of each joint's interval, give or take ``apart``."""
    if brakes is not None and brakes.get("apart") is not None:
        earliest = [float(lo) for lo, _ in brakes["delay"]]
        brakes["lag"] = [lo - min(earliest) for lo in earliest]
