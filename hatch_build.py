"""Part of the wheel's build: compiles the C core beside its Python binding, so that nothing is compiled where stopset runs.

A plain build compiles for this machine, by its C compiler or, where it has none, by zig, which pip then fetches for the
build alone.  ``STOPSET_TARGET=linux-aarch64`` (a key of `TARGETS`) makes a release wheel for another platform with zig.
"""

from __future__ import annotations

import importlib.util
import os
import sysconfig
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

CORE = Path(__file__).parent / "model" / "stopset" / "core"


def _core_build() -> Any:
    """``stopset.core.build``, which is not installed yet."""
    spec = importlib.util.spec_from_file_location("stopset_core_build", CORE / "build.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class CustomBuildHook(BuildHookInterface[Any]):
    """Compiles the core before the wheel is filled; an editable install finds it in the source tree."""

    def dependencies(self) -> list[str]:
        """zig, where this machine has no C compiler or compiles for another one."""
        foreign = bool(os.environ.get("STOPSET_TARGET"))
        return ["ziglang>=0.13"] if foreign or _core_build().system_compiler() is None else []

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile, and say which platform the wheel is for: any Python 3, one machine."""
        core, target = _core_build(), os.environ.get("STOPSET_TARGET") or None
        platform = core.TARGETS[target][1] if target else sysconfig.get_platform().replace("-", "_").replace(".", "_")
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{platform}"
        if version == "editable":
            core.build()
            return
        folder = Path(self.directory).resolve() / "core" / (target or "here")
        for made in (core.compile_core(folder, target), core.write_binding(folder)):
            build_data["force_include"][str(made)] = f"stopset/core/{made.name}"
