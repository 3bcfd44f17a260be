"""HTML of the page: its head, and elements of panels in one style."""

import gzip
from collections.abc import Iterable
from functools import lru_cache
from html import escape
from pathlib import Path

from app.errors import DbbError

RIGHT = "text-align:right"
FAINT = "opacity:.8"
ONE_LINE = "white-space:nowrap"
_BANNERS = {"error": "#c92a2a", "notice": "#1971c2"}
_SCRIPT, _CONTROLS, _STYLE = (
    Path(__file__).with_name(name).read_text(encoding="utf-8")
    for name in ("page.js", "controls.js", "page.css")
)
_HEAD = f'<head><meta charset="utf-8"><script>{_SCRIPT}{_CONTROLS}</script><style>{_STYLE}</style>'
DEFECT = "A defect of the program; the log in the terminal has the details."


def plain(error: BaseException) -> str:
    """Return an exception's text for viewers: its message if it is a `DbbError`, else `DEFECT`."""
    return str(error) if isinstance(error, DbbError) else DEFECT


@lru_cache(maxsize=2)
def with_head(page: bytes, encoding: str) -> bytes:
    """Return viser's page with this program's scripts; `encoding` is "gzip" if it is compressed."""
    html = (gzip.decompress if encoding == "gzip" else bytes)(page)
    html = html.replace(b"<head>", _HEAD.encode(), 1)
    return gzip.compress(html) if encoding == "gzip" else html


def small(html: str, *styles: str) -> str:
    """Return a block in the small type of panels, with further CSS `styles`."""
    look = "padding:.2em .7em;font-size:.82em;line-height:1.5;overflow-wrap:anywhere"
    return tag("div", html, look, *styles)


def problem(text: str) -> str:
    """Return a text in the colour of errors; the text is escaped."""
    return tag("span", escape(text), "color:light-dark(#c92a2a, #ff8787)")


def banner(kind: str, title: str, text: str) -> str:
    """Return a coloured box of the kind "error" or "notice"; title and text are escaped."""
    look = "margin:.5em .7em;padding:.5em .7em;border-radius:4px;color:white;font-size:.85em"
    html, ground = f"<b>{escape(title)}</b><br>{escape(text)}", f"background:{_BANNERS[kind]}"
    return tag("div", html, look, "overflow-wrap:anywhere", ground)


def table(rows: Iterable[str], *styles: str, tight: bool = False) -> str:
    """Return a table of rows from `row`, as wide as its panel; `tight` cells have no padding."""
    look, padding = "width:100%;font-variant-numeric:tabular-nums", "0" if tight else ""
    return tag("table", "".join(rows), look, *styles, cellpadding=padding)


def row(*cells: str, hint: str = "", style: str = "") -> str:
    """Return a row of cells from `cell`; `hint` appears while the pointer is over the row."""
    return tag("tr", "".join(cells), style, title=escape(hint))


def cell(html: str = "", *styles: str, span: int = 1, head: bool = False) -> str:
    """Return a cell that covers `span` columns; `head` marks the title of a column."""
    across = f"{span}" if span > 1 else ""
    return tag("th" if head else "td", html, *styles, colspan=across)


def reading(name: str, value: str) -> str:
    return row(cell(name, FAINT, ONE_LINE), cell(value, RIGHT))


def bar(share: float, colour: str = "currentColor", stroke: float | None = None) -> str:
    """Return a bar that is filled to `share` (0 to 1), with a mark at `stroke` (0 to 1) if any."""
    filled = f"width:{100 * share:.0f}%;height:100%;background:{colour};border-radius:2px"
    html = tag("div", "", filled)
    if stroke is not None:
        place = f"position:absolute;left:{100 * stroke:.0f}%;top:-.15em"
        html += tag("div", "", place, "width:1px;height:.85em;background:currentColor;opacity:.7")
    ground = "position:relative;height:.55em;background:rgba(128,138,150,.22);border-radius:2px"
    return tag("div", html, ground)


def mark(sign: str, colour: str) -> str:
    return tag("b", sign, f"color:{colour}")


def minus(text: str) -> str:
    return text.replace("-", "−")


def tag(name: str, html: str, *styles: str, **attributes: str) -> str:
    """Return an element with the content `html`; empty styles and attributes are omitted."""
    attributes["style"] = ";".join(filter(None, styles))
    texts = (f' {key}="{value}"' for key, value in attributes.items() if value)
    return f"<{name}{''.join(texts)}>{html}</{name}>"
