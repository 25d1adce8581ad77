"""A small PDF writer: text, rules and curves on A4, in Helvetica, with no library."""

from __future__ import annotations

import math
import textwrap
import zlib
from collections.abc import Sequence
from dataclasses import dataclass

WIDTH, HEIGHT, MARGIN = 595.0, 842.0, 42.0  # [pt] A4
PICTURE = 170.0  # [pt] height of a picture with its words
INKS = ("0 0.45 0.7", "0.84 0.37 0", "0 0.62 0.45", "0.8 0.47 0.65")


@dataclass(frozen=True, slots=True)
class Plot:
    """Curves (name, x, y) and measured points (x, y), both axes from zero."""

    title: str
    curves: Sequence[tuple[str, Sequence[float], Sequence[float]]]
    points: tuple[Sequence[float], Sequence[float]]
    x_name: str
    y_name: str


def _step(top: float) -> float:
    """A round distance of grid lines, four to eight of them up to ``top``."""
    if not 0.0 < top < math.inf:
        return 0.25
    base = 10.0 ** math.floor(math.log10(top / 4.0))
    return base * next(f for f in (1.0, 2.0, 2.5, 5.0, 10.0) if top / (f * base) <= 8.0)


class Document:
    """Collects pages from top to bottom; `bytes` gives the file."""

    def __init__(self, title: str, footer: str) -> None:
        self._title, self._footer = title, footer
        self._pages: list[list[str]] = []
        self._y = 0.0
        self._new_page()

    def _new_page(self) -> None:
        self._pages.append([])
        self._y = HEIGHT - MARGIN
        self._put(MARGIN, 24.0, self._footer, 6.5)
        self._put(WIDTH - MARGIN - 20, 24.0, str(len(self._pages)), 6.5)

    def _put(self, x: float, y: float, text: str, size: float, *, bold: bool = False) -> None:
        safe = text.encode("cp1252", "replace").replace(b"\\", b"\\\\").replace(b"(", b"\\(").replace(b")", b"\\)")
        font = "F2" if bold else "F1"
        self._pages[-1].append(f"BT /{font} {size} Tf {x:.2f} {y:.2f} Td ({safe.decode('cp1252')}) Tj ET")

    def _room(self, height: float) -> None:
        if self._y - height < MARGIN:
            self._new_page()

    def heading(self, text: str, size: float = 13.0, keep: float = 0.0) -> None:
        """``keep``: height [pt] of what must stand below it on the same page."""
        self._room(3 * size + keep)
        self._y -= 1.5 * size
        self._put(MARGIN, self._y, text, size, bold=True)
        self._y -= 0.5 * size

    def text(self, text: str, size: float = 8.5) -> None:
        """A paragraph, wrapped by an average letter's width."""
        width = int((WIDTH - 2 * MARGIN) / (0.5 * size))
        line = ""
        for word in [*text.split(), ""]:
            if len(line) + len(word) + 1 > width or not word:
                self._room(1.3 * size)
                self._y -= 1.3 * size
                self._put(MARGIN, self._y, line, size)
                line = word
            else:
                line = f"{line} {word}".strip()

    def table(self, head: Sequence[str], rows: Sequence[Sequence[str]], widths: Sequence[float], size: float = 7.0) -> None:
        """``widths``: shares of the text width. A long last cell goes on below; every page repeats the head."""
        scale = (WIDTH - 2 * MARGIN) / sum(widths)
        self._room(4.2 * size)
        self._line(head, widths, scale, size, bold=True)
        for row in rows:
            letters = max(8, int(widths[-1] * scale / (0.46 * size)))
            last = textwrap.wrap(row[-1], letters) or [""]
            if self._y - 1.4 * size * len(last) < MARGIN:
                self._new_page()
                self._line(head, widths, scale, size, bold=True)
            for k, part in enumerate(last):
                cells = [*row[:-1], part] if k == 0 else [""] * (len(row) - 1) + [part]
                self._line(cells, widths, scale, size, rule=k == len(last) - 1)
        self._y -= size

    def _line(
        self, row: Sequence[str], widths: Sequence[float], scale: float, size: float, *, bold: bool = False, rule: bool = True
    ) -> None:
        self._y -= 1.4 * size
        x = MARGIN
        for cell, w in zip(row, widths, strict=True):
            self._put(x, self._y, cell[: max(1, int(w * scale / (0.46 * size)))], size, bold=bold)
            x += w * scale
        if rule:
            self._pages[-1].append(f"0.8 G 0.3 w {MARGIN:.1f} {self._y - 2:.2f} m {WIDTH - MARGIN:.1f} {self._y - 2:.2f} l S 0 G")

    def plots(self, plots: Sequence[Plot]) -> None:
        """Pictures side by side."""
        self._room(PICTURE)
        width = (WIDTH - 2 * MARGIN) / len(plots)
        for k, plot in enumerate(plots):
            self._plot(plot, MARGIN + k * width, width - 14.0, PICTURE - 52.0)
        self._y -= PICTURE

    def _plot(self, p: Plot, left: float, width: float, height: float) -> None:
        x0, y0, w = left + 34.0, self._y - 18.0 - height, width - 34.0
        xs = [v for _, x, _ in p.curves for v in x] + list(p.points[0])
        ys = [v for _, _, y in p.curves for v in y] + list(p.points[1])
        steps = _step(max(xs, default=1.0)), _step(max(ys, default=1.0))
        x1, y1 = (step * max(1, math.ceil(max(v, default=1.0) / step - 1e-9)) for step, v in zip(steps, (xs, ys), strict=True))
        page = self._pages[-1]
        self._put(left, self._y - 10, f"{p.title}: {p.y_name}", 7.5, bold=True)
        for k in range(round(x1 / steps[0]) + 1):
            x = x0 + w * k * steps[0] / x1
            page.append(f"0.88 G 0.4 w {x:.1f} {y0:.1f} m {x:.1f} {y0 + height:.1f} l S 0 G")
            self._put(x - 4, y0 - 9, f"{k * steps[0]:.4g}", 6.0)
        for k in range(round(y1 / steps[1]) + 1):
            y = y0 + height * k * steps[1] / y1
            page.append(f"0.88 G 0.4 w {x0:.1f} {y:.1f} m {x0 + w:.1f} {y:.1f} l S 0 G")
            self._put(x0 - 24, y - 2, f"{k * steps[1]:.4g}", 6.0)
        self._put(x0 + w - 40, y0 - 18, p.x_name, 6.5)
        page.append(f"0.6 w {x0:.1f} {y0 + height:.1f} m {x0:.1f} {y0:.1f} l {x0 + w:.1f} {y0:.1f} l S")
        for k, (name, cx, cy) in enumerate(p.curves):
            path = " ".join(
                f"{x0 + w * a / x1:.2f} {y0 + height * b / y1:.2f} {'m' if i == 0 else 'l'}"
                for i, (a, b) in enumerate(zip(cx, cy, strict=True))
            )
            page.append(f"{INKS[k % len(INKS)]} RG 1.2 w {path} S 0 G {INKS[k % len(INKS)]} rg")
            self._put(x0 + 6 + 52 * k, y0 - 18, name, 6.5)
            page.append("0 g")
        for a, b in zip(*p.points, strict=True):
            x, y = x0 + w * a / x1, y0 + height * b / y1
            arms = ((-1.5, -1.5, "m"), (1.5, 1.5, "l"), (-1.5, 1.5, "m"), (1.5, -1.5, "l"))
            page.append("0.6 w " + " ".join(f"{x + dx:.2f} {y + dy:.2f} {op}" for dx, dy, op in arms) + " S")

    def bytes(self) -> bytes:
        """The PDF file."""
        objects: list[bytes] = [b"<< /Type /Catalog /Pages 2 0 R >>", b""]
        objects.append(b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica /Encoding /WinAnsiEncoding >>")
        objects.append(b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica-Bold /Encoding /WinAnsiEncoding >>")
        kids = []
        for page in self._pages:
            stream = zlib.compress("\n".join(page).encode("cp1252", "replace"))
            objects.append(b"<< /Length %d /Filter /FlateDecode >>\nstream\n" % len(stream) + stream + b"\nendstream")
            kids.append(len(objects) + 1)
            objects.append(
                b"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 %d %d] /Contents %d 0 R "
                b"/Resources << /Font << /F1 3 0 R /F2 4 0 R >> >> >>" % (WIDTH, HEIGHT, len(objects))
            )
        objects[1] = b"<< /Type /Pages /Count %d /Kids [%s] >>" % (len(kids), b" ".join(b"%d 0 R" % k for k in kids))
        title = self._title.encode("cp1252", "replace").replace(b"(", b"\\(").replace(b")", b"\\)")
        objects.append(b"<< /Title (" + title + b") /Producer (stopset) >>")
        out = bytearray(b"%PDF-1.4\n")
        offsets = []
        for k, body in enumerate(objects, 1):
            offsets.append(len(out))
            out += b"%d 0 obj\n" % k + body + b"\nendobj\n"
        xref = len(out)
        out += b"xref\n0 %d\n0000000000 65535 f \n" % (len(objects) + 1)
        out += b"".join(b"%010d 00000 n \n" % o for o in offsets)
        out += b"trailer << /Size %d /Root 1 0 R /Info %d 0 R >>\nstartxref\n%d\n%%%%EOF\n" % (
            len(objects) + 1, len(objects), xref,
        )  # fmt: skip
        return bytes(out)
