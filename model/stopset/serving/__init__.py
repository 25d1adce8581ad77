"""What the served pages share: who is answered, what the browser may run, and the drawing of the arm."""

from stopset.serving.server import CONNECTIONS, Handler, PageServer, loopback, own_file

__all__ = ["CONNECTIONS", "Handler", "PageServer", "loopback", "own_file"]
