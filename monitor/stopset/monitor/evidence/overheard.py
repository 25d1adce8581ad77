"""An outlet whose slow messages the recorder hears too, before they leave."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from stopset.monitor.evidence.recorder import Recorder
from stopset.monitor.publisher import Outlet


@dataclass(frozen=True, slots=True)
class Overheard:
    """Passes everything on to ``outlet``."""

    outlet: Outlet
    recorder: Recorder

    def fast(self, name: str) -> Callable[[bytes], None]:
        return self.outlet.fast(name)

    def put(self, name: str, data: bytes | str, *, must_arrive: bool = False) -> None:
        self.recorder.overhear(name, data if isinstance(data, bytes) else data.encode())
        self.outlet.put(name, data, must_arrive=must_arrive)

    def subscribe(self, name: str, handler: Callable[[str, bytes], None]) -> None:
        self.outlet.subscribe(name, handler)

    def serve(self, name: str, answer: Callable[[], bytes]) -> None:
        self.outlet.serve(name, answer)

    def alive(self, name: str) -> None:
        self.outlet.alive(name)
