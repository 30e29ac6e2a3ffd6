"""HTML pages without a server: their frame, tables, and figures as SVG."""

import io
from collections.abc import Sequence
from html import escape
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{title}</title>
<style>
:root {{ color-scheme: light dark }}
body {{ font: 16px/1.5 system-ui, sans-serif; max-width: 52rem; margin: 2rem auto }}
table {{ border-collapse: collapse }} td, th {{ padding: .2rem .8rem; text-align: left }}
th {{ border-bottom: 1px solid #999 }} svg {{ max-width: 100%; height: auto }}
.finding {{ font-size: 1.3rem }} .wide {{ overflow-x: auto }}
@media (max-width: 54rem) {{ body {{ margin: 1rem }} .wide svg {{ max-width: none }} }}
@media (prefers-color-scheme: dark) {{ svg {{ filter: invert(.92) hue-rotate(180deg) }} }}
</style></head><body>
<h1>{title}</h1>
{body}
</body></html>
"""


def page(title: str, body: Sequence[str]) -> str:
    """A page with this title (text) and these parts (HTML)."""
    return _PAGE.format(title=escape(title), body="\n".join(body))


def table(heads: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """A table with heads (texts) and cells (HTML)."""
    head = "".join(f"<th>{escape(h)}</th>" for h in heads)
    body = "".join("<tr>" + "".join(f"<td>{c}</td>" for c in row) + "</tr>" for row in rows)
    return wide(f"<table><tr>{head}</tr>{body}</table>")


def wide(content: str) -> str:
    """HTML that scrolls on its own where a page is narrower."""
    return f'<div class="wide" tabindex="0">{content}</div>'


def svg(figure: Figure) -> str:
    """A figure as SVG; the same figure gives the same bytes."""
    with mpl.rc_context({"svg.hashsalt": "adr", "svg.fonttype": "none"}):
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    return buffer.getvalue()
