"""One compared recording as an MCAP file, in topics that Foxglove knows: the arm in space, and each joint within its prediction."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType, Writer

from stopset.artifact import Model
from stopset.files import write_bytes
from stopset.offline.compare.scene import Scene

ARM, BAD = (0.15, 0.2, 0.24), (0.69, 0.0, 0.13)  # colours of the links, and of the joint that fails
FRAMES_S = 0.04  # [s] between two pictures of the arm; the lines have every sample
NUMBER = {"type": ["number", "null"]}
JOINT = {
    "title": "stopset.Joint",
    "type": "object",
    "properties": dict.fromkeys(("q_rad", "lo_rad", "hi_rad", "outside_rad"), NUMBER),
}
# well known to the viewers by its name; the parts that are used here
SCENE = {
    "title": "foxglove.SceneUpdate",
    "type": "object",
    "properties": {"entities": {"type": "array", "items": {"type": "object"}}},
}


def save_mcap(path: str | Path, model: Model, scene: Scene) -> None:
    """Write ``scene`` (`stopset.offline.compare.scene.scene`), whole or not at all; raises `OutputError`.

    Topics ``arm`` and ``joint/<name>`` [rad]: where the joint was, between which bounds it was predicted, and by how much it left them.
    """
    stream = BytesIO()
    out = Writer(stream, compression=CompressionType.ZSTD)
    out.start(profile="", library="stopset")
    out.add_metadata("stopset", {"model_sha256": model.sha256, "robot": model.robot.name, "recording": scene.label})
    number = {
        schema["title"]: out.register_schema(str(schema["title"]), "jsonschema", json.dumps(schema).encode())
        for schema in (JOINT, SCENE)
    }
    names = {f"joint/{j}": "stopset.Joint" for j in model.joints} | {"arm": "foxglove.SceneUpdate"}
    channel = {topic: out.register_channel(topic, "json", number[title]) for topic, title in names.items()}
    for t, topic, message in sorted(_messages(model, scene), key=lambda m: m[0]):
        out.add_message(channel[topic], log_time=t, publish_time=t, data=json.dumps(message).encode())
    out.finish()  # type: ignore[no-untyped-call]
    write_bytes(path, stream.getvalue())


def _messages(model: Model, s: Scene) -> Iterator[tuple[int, str, Mapping[str, Any]]]:
    """(time [ns] from the recording's start, topic, message)."""
    times = np.round(1e9 * s.t).astype(int).tolist()
    for i, t in enumerate(times):
        for k, j in enumerate(model.joints):
            q = float(s.q[i, k])
            lo, hi = (float(b[i, k]) if i < len(b) and np.isfinite(b[i, k]) else None for b in (s.lo, s.hi))
            outside = None if lo is None or hi is None else max(lo - q, q - hi, 0.0)
            yield t, f"joint/{j}", {"q_rad": q, "lo_rad": lo, "hi_rad": hi, "outside_rad": outside}
    step = max(1, round(FRAMES_S / float(np.diff(s.t).mean())))
    for i in range(0, len(times), step):
        yield times[i], "arm", {"deletions": [], "entities": [_arm(model, s, i, times[i])]}


def _arm(model: Model, s: Scene, i: int, t: int) -> dict[str, Any]:
    """The links as one line, a ball at each joint, that of the failing one red."""
    points = [dict(zip("xyz", map(float, p), strict=True)) for p in model.robot.outline(s.q[i])]
    pose = {"position": {"x": 0.0, "y": 0.0, "z": 0.0}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
    line = {
        "type": 0,
        "pose": pose,
        "thickness": 0.02,
        "scale_invariant": False,
        "points": points,
        "color": _colour(ARM),
        "colors": [],
        "indices": [],
    }
    balls = [
        {"pose": pose | {"position": p}, "size": dict.fromkeys("xyz", 0.05), "color": _colour(BAD if j == s.fails else ARM)}
        for j, p in zip(model.joints, points[1:-1], strict=True)
    ]
    return {
        "timestamp": {"sec": t // 10**9, "nsec": t % 10**9}, "frame_id": "base", "id": "arm", "lifetime": {"sec": 0, "nsec": 0},
        "frame_locked": False, "metadata": [], "arrows": [], "cubes": [], "spheres": balls, "cylinders": [], "lines": [line],
        "triangles": [], "texts": [], "models": [],
    }  # fmt: skip


def _colour(rgb: tuple[float, float, float]) -> dict[str, float]:
    return dict(zip("rgb", rgb, strict=True)) | {"a": 1.0}
