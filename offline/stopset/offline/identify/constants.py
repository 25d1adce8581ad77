"""Every constant that the result of an identification rests on besides the user's settings, by module and name (trap P18)."""

from __future__ import annotations

import pkgutil
from functools import cache
from importlib import import_module
from typing import Any

# what stands between recordings and model file; capitals in these modules, and in those of these packages, are constants
WHERE = (
    "stopset.offline.abstraction", "stopset.offline.brakes", "stopset.offline.campaign", "stopset.offline.compare.metrics",
    "stopset.offline.conform", "stopset.offline.identify.settings", "stopset.offline.nominal",
    "stopset.reach.flowpipe", "stopset.reach.nonlinear",
)  # fmt: skip


@cache
def constants() -> dict[str, Any]:
    """``module.NAME`` -> number, text or tuple of these, as written in the code of this version."""
    out = {}
    for name in WHERE:
        package = import_module(name)
        inside = [m.name for m in pkgutil.iter_modules(getattr(package, "__path__", []), f"{name}.")]
        for module in (package, *map(import_module, inside)):
            for key, value in vars(module).items():
                if key.isupper() and _plain(value):
                    out[f"{module.__name__}.{key}"] = value
    return dict(sorted(out.items()))


def _plain(value: Any) -> bool:
    return all(map(_plain, value)) if isinstance(value, tuple) else isinstance(value, (int, float, str))
