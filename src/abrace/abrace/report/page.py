# SPDX-License-Identifier: Apache-2.0
"""A report as one self-contained page of HTML: tables, charts that zoom, figures, a style for screen and paper.

Plotly, charts and figures are compressed in the page, so that it stays small; the browser decompresses and draws them.
"""

from __future__ import annotations

import base64
import gzip
import json
from functools import cache
from html import escape
from typing import TYPE_CHECKING, Any

from plotly.offline import get_plotlyjs

from abrace.report.page_style import SCRIPT, STYLE
from abrace.report.sections import Listing, Part, Picture
from abrace.report.table import Table

if TYPE_CHECKING:
    from collections.abc import Sequence

    from abrace.report.sections import Section

LEVEL = 4
"""Level of compression: the highest takes twice as long for a page that is 2 % smaller."""


def page(title: str, subtitle: str, sections: Sequence[Section]) -> str:
    """The page with this `title`, a `subtitle` below it, and these `sections`."""
    drawn: dict[str, Any] = {}
    bodies = []
    for number, section in enumerate(sections, 1):
        parts = "\n".join(_part(part, drawn) for part in section.parts)
        bodies.append(f'<section id="s{number}"><h2>{escape(section.title)}</h2>\n{parts}\n</section>')
    links = "".join(f'<a href="#s{i}">{escape(section.title)}</a>' for i, section in enumerate(sections, 1))
    packed = {"figures": _packed(json.dumps(drawn, separators=(",", ":")))}
    if any(isinstance(figure, dict) for figure in drawn.values()):
        packed["plotly"] = _plotly()
    scripts = "\n".join(f'<script type="application/gzip" id="{name}">{text}</script>' for name, text in packed.items())
    return f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>{escape(title)}</title><style>{STYLE}</style></head>
<body><header><h1>{escape(title)}</h1><p>{escape(subtitle)}</p></header>
<nav>{links}</nav>
<main>
{chr(10).join(bodies)}
</main>
{scripts}
<script>{SCRIPT}</script>
</body></html>
"""


def _part(part: Part, drawn: dict[str, Any]) -> str:
    if isinstance(part, Table):
        return _table(part)
    if isinstance(part, Listing):
        return f"<pre>{escape(part.text)}</pre>"
    if isinstance(part, Picture):
        return _picture(part, drawn)
    return f"<p>{escape(part)}</p>"


def _table(table: Table) -> str:
    title = f"<h3>{escape(table.title)}</h3>" if table.title else ""
    head = "".join(f"<th>{escape(cell)}</th>" for cell in table.header)
    rows = "\n".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in table.rows)
    notes = "".join(f"<p class=note>{escape(note)}</p>" for note in table.notes)
    return f"{title}<div class=wide><table><thead><tr>{head}</tr></thead><tbody>\n{rows}\n</tbody></table></div>{notes}"


def _picture(picture: Picture, drawn: dict[str, Any]) -> str:
    caption = f"<figcaption>{escape(picture.caption or picture.title)}</figcaption>"
    name = f"f{len(drawn)}"
    drawn[name] = picture.plotly or picture.path.read_text(encoding="utf-8")
    height = f"height:{picture.plotly['layout']['height']}px" if picture.plotly else ""
    return (
        f'<figure><div data-figure="{name}" title="{escape(picture.title)}" style="{height}"></div>{caption}</figure>'
    )


@cache
def _plotly() -> str:
    return _packed(get_plotlyjs())


def _packed(text: str) -> str:
    return base64.b64encode(gzip.compress(text.encode(), LEVEL, mtime=0)).decode()
