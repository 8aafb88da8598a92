"""HTML of a report: escaped text, tables, sections, and the page around them."""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Iterable, Sequence
from html import escape
from importlib.resources import files
from typing import Any, NamedTuple


class Cell(NamedTuple):
    """A figure of a table, right-aligned; `best`: shown in bold."""

    text: str
    best: bool = False


class Link(NamedTuple):
    """A text that leads to another page."""

    text: str
    address: str


Row = list[str | Cell | Link]  # of a table: texts to the left, `Cell`s to the right


def paragraph(text: str, kind: str = "") -> str:
    """One paragraph."""
    return f'<p class="{kind}">{escape(text)}</p>' if kind else f"<p>{escape(text)}</p>"


def table(headings: Sequence[str], rows: Iterable[Row], caption: str, name: str = "") -> str:
    """A table."""
    lines = list(rows)
    right = [any(isinstance(line[column], Cell) for line in lines) for column in range(len(headings))]
    kinds = [' class="figure"' if one else "" for one in right]
    head = "".join(f'<th scope="col"{kind}>{escape(text)}</th>' for text, kind in zip(headings, kinds, strict=True))
    body = "".join(f"<tr>{''.join(map(_cell, line))}</tr>" for line in lines)
    return (
        f'<div class="wide"><table id="{escape(name)}"><caption>{escape(caption)}</caption>'
        f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>"
    )


def _cell(cell: str | Cell | Link) -> str:
    if isinstance(cell, Link):
        return f'<td><a href="{escape(cell.address)}">{escape(cell.text)}</a></td>'
    if isinstance(cell, Cell):
        text = f"<b>{escape(cell.text)}</b>" if cell.best else escape(cell.text)
        return f'<td class="figure">{text}</td>'
    return f"<td>{escape(cell)}</td>"


def plot(name: str, title: str, explanation: str) -> str:
    """The place of a plot, with a title above and one sentence below."""
    label = escape(f"{title}. {explanation}")
    return (
        f'<figure><h3>{escape(title)}</h3><div class="chart" id="{escape(name)}" role="img" aria-label="{label}"></div>'
        f"<figcaption>{escape(explanation)}</figcaption></figure>"
    )


def section(name: str, title: str, body: str, *, open_: bool = True) -> str:
    """A section that folds."""
    state = " open" if open_ else ""
    return f'<details id="{name}"{state}><summary><h2>{escape(title)}</h2></summary>{body}</details>'


def page(title: str, body: str, figures: dict[str, Any], document: Any, library: str) -> str:
    """The whole page. It carries all that it needs, and forbids the browser any request.

    Args:
        figures: by the name of their place.
        document: the JSON of `evaluate`, kept in the page as `#document`.
        library: source of plotly.js; "": the page has no plots.
    """
    here = files(__package__)
    style, script = ((here / name).read_text(encoding="utf-8") for name in ("page.css", "page.js"))
    packed = base64.b64encode(gzip.compress(library.encode(), mtime=0)).decode() if library else ""
    scripts = (
        f'<script type="text/plain" id="library">{packed}</script>\n'
        f'<script type="application/json" id="figures">{_json(figures)}</script>\n'
        f"<script>{script}</script>\n"
        if library
        else ""
    )
    policy = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:"
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<title>{escape(title)}</title>
<style>{style}</style>
</head>
<body>
{body}
<script type="application/json" id="document">{_json(document)}</script>
{scripts}</body>
</html>
"""


def _json(value: Any) -> str:
    """For a script element, which must not hold its own end."""
    return json.dumps(value, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
