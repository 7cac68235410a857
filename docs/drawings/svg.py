# SPDX-License-Identifier: Apache-2.0
"""Drawings in SVG: boxes, lines, arrows and words, in the colours of the documentation."""

from __future__ import annotations

from html import escape

INK, PALE, BLUE, RED, GREEN, GREY = "#222222", "#f2f5f8", "#1f5f99", "#b3261e", "#2e7d32", "#888888"
SIZE = 14
"""Height of letters [px]."""


class Drawing:
    """A drawing of some `width` and `height` [px] with a white background, which reads in light and dark pages."""

    def __init__(self, width: int, height: int) -> None:
        self.width, self.height = width, height
        self._parts: list[str] = []

    def box(
        self, x: float, y: float, width: float, height: float, words: str = "", *, fill: str = PALE, edge: str = INK
    ) -> None:
        """A rounded box, its lines of `words` in the middle."""
        self._parts.append(
            f'<rect x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" rx="5" fill="{fill}" stroke="{edge}"/>'
        )
        self.words(x + width / 2, y + height / 2, words)

    def line(self, *points: tuple[float, float], edge: str = INK, width: float = 1.5, dashed: bool = False) -> None:
        """A line through `points`."""
        self._path(points, edge, width, dashed, "")

    def arrow(self, *points: tuple[float, float], edge: str = INK, width: float = 1.5, dashed: bool = False) -> None:
        """A line through `points` with a head at its end."""
        self._path(points, edge, width, dashed, f' marker-end="url(#head-{edge[1:]})"')

    def circle(self, x: float, y: float, radius: float, *, fill: str = INK) -> None:
        """A filled circle."""
        self._parts.append(f'<circle cx="{x:g}" cy="{y:g}" r="{radius:g}" fill="{fill}" stroke="{INK}"/>')

    def words(
        self, x: float, y: float, words: str, *, colour: str = INK, anchor: str = "middle", bold: bool = False
    ) -> None:
        """Lines of text around the height `y`; `anchor`: start, middle or end."""
        lines = words.split("\n") if words else []
        weight = ' font-weight="bold"' if bold else ""
        for number, text in enumerate(lines):
            height = y + (number - (len(lines) - 1) / 2) * 1.2 * SIZE + 0.35 * SIZE
            self._parts.append(
                f'<text x="{x:g}" y="{height:g}" fill="{colour}" text-anchor="{anchor}"{weight}>{escape(text)}</text>'
            )

    def screen(self, x: float, y: float, lines: list[str], red: str = "\0") -> None:
        """Lines of a terminal from (x, y) on; those that contain `red` are red."""
        for number, text in enumerate(lines):
            colour = RED if red in text else INK
            self._parts.append(
                f'<text x="{x:g}" y="{y + 1.35 * SIZE * number:g}" fill="{colour}" font-family="monospace" '
                f'xml:space="preserve">{escape(text)}</text>'
            )

    def _path(self, points: tuple[tuple[float, float], ...], edge: str, width: float, dashed: bool, head: str) -> None:
        steps = " ".join(f"{x:g},{y:g}" for x, y in points)
        dashes = ' stroke-dasharray="6 4"' if dashed else ""
        self._parts.append(
            f'<polyline points="{steps}" fill="none" stroke="{edge}" stroke-width="{width:g}"{dashes}{head}/>'
        )

    def text(self) -> str:
        """The file's content."""
        heads = "\n".join(
            f'<marker id="head-{colour[1:]}" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="7" markerHeight="7" '
            f'orient="auto"><path d="M0,0 L10,5 L0,10 z" fill="{colour}"/></marker>'
            for colour in (INK, BLUE, RED, GREEN, GREY)
        )
        size = f'viewBox="0 0 {self.width} {self.height}" width="{self.width}"'
        font = f'font-family="Helvetica, Arial, sans-serif" font-size="{SIZE}"'
        return "\n".join(
            [
                f'<svg xmlns="http://www.w3.org/2000/svg" {size} {font}>',
                f"<defs>\n{heads}\n</defs>",
                f'<rect width="{self.width}" height="{self.height}" fill="white"/>',
                *self._parts,
                "</svg>\n",
            ]
        )
