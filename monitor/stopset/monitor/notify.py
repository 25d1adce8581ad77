"""Words to systemd over its datagram socket; silent where there is none."""

from __future__ import annotations

import contextlib
import os
import socket


class Notifier:
    """``READY=1``, ``WATCHDOG=1``, ``STATUS=...``, ``STOPPING=1``."""

    def __init__(self) -> None:
        path = os.environ.get("NOTIFY_SOCKET", "")
        self._socket: socket.socket | None = None
        if path:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
            self._socket.settimeout(0.0)
            self._address = "\0" + path[1:] if path.startswith("@") else path

    def say(self, *words: str) -> None:
        """Send; a full or missing socket must not hurt the loop."""
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.sendto("\n".join(words).encode(), self._address)
