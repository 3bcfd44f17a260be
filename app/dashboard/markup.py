"""HTML of panels: text, tables and banners of one look."""

from collections.abc import Iterable, Mapping
from html import escape

from app.errors import DbbError

RIGHT = "text-align:right"
FAINT = "opacity:.8"
ONE_LINE = "white-space:nowrap"
BAD_COLOUR = "light-dark(#c92a2a, #ff8787)"
_BANNERS = {"error": "#c92a2a", "notice": "#1971c2"}

DEFECT = "A defect of the program; its log, where it was started, says which."
"""What a page shows of an exception that no user can cause."""


def plain(error: BaseException) -> str:
    """What a page says of an error: never the name of a Python exception."""
    return str(error) if isinstance(error, DbbError) else DEFECT


def small(html: str, *styles: str) -> str:
    """Text of a panel."""
    look = "padding:.2em .7em;font-size:.82em;line-height:1.5;overflow-wrap:anywhere"
    return _tag("div", html, look, *styles)


def framed(html: str, colour: str) -> str:
    """The same with a frame of a colour."""
    frame = f"border:1px solid {colour};border-left:6px solid {colour};margin:.4em .7em"
    return small(html, frame)


def problem(text: str) -> str:
    """A text that says what went wrong, which may hold anything."""
    return _tag("span", escape(text), f"color:{BAD_COLOUR}")


def banner(kind: str, title: str, text: str) -> str:
    """What stands above all tabs: an "error" or a "notice", whose texts may hold anything."""
    return _tag(
        "div",
        f"<b>{escape(title)}</b><br>{escape(text)}",
        "margin:.5em .7em;padding:.5em .7em;border-radius:4px;color:white;font-size:.85em",
        "overflow-wrap:anywhere",
        f"background:{_BANNERS[kind]}",
    )


def table(rows: Iterable[str], *styles: str, tight: bool = False) -> str:
    """A table of rows, each made by `row`, as wide as its panel; `tight` if its cells touch."""
    style = _style("width:100%;font-variant-numeric:tabular-nums", *styles)
    space = ' cellpadding="0"' if tight else ""
    return f"<table{space}{style}>{''.join(rows)}</table>"


def row(*cells: str, hint: str = "", style: str = "") -> str:
    """A row of cells, each made by `cell`, with a text for the pointer over it."""
    title = f' title="{escape(hint)}"' if hint else ""
    return f"<tr{title}{_style(style)}>{''.join(cells)}</tr>"


def cell(html: str = "", *styles: str, span: int = 1, head: bool = False) -> str:
    """A cell over so many columns; `head` for the title of a column of data."""
    name, across = "th" if head else "td", f' colspan="{span}"' if span > 1 else ""
    return f"<{name}{across}{_style(*styles)}>{html}</{name}>"


def readings(values: Mapping[str, str], *styles: str) -> str:
    """A table of what is read, by its name; styles are the table's."""
    return table((reading(*each) for each in values.items()), *styles)


def reading(name: str, value: str) -> str:
    """A row of a reading: its name and value."""
    return row(cell(name, FAINT), cell(value, RIGHT))


def spread(*texts: str) -> str:
    """Texts over the width of the panel, the first at its left and the last at its right end."""
    style = "display:flex;justify-content:space-between;font-variant-numeric:tabular-nums"
    return _tag("div", "".join(_tag("span", text) for text in texts), style)


def grid(heads: Iterable[str], rows: Iterable[Iterable[str]], *styles: str) -> str:
    """A table of numbers below their heads; the first of each row is its name."""
    head = row(*(cell(name, RIGHT, head=True) for name in heads))
    body = (row(cell(name), *(cell(text, RIGHT) for text in texts)) for name, *texts in rows)
    return table((head, *body), *styles)


def bar(share: float, colour: str = "currentColor", stroke: float | None = None) -> str:
    """A bar that is filled by a share, 0 to 1; with a stroke at another one."""
    filled = f"width:{100 * share:.0f}%;height:100%;background:{colour};border-radius:2px"
    html = _tag("div", "", filled)
    if stroke is not None:
        place = f"position:absolute;left:{100 * stroke:.0f}%;top:-.15em"
        html += _tag("div", "", place, "width:1px;height:.85em;background:currentColor;opacity:.7")
    ground = "position:relative;height:.55em;background:rgba(128,138,150,.22);border-radius:2px"
    return _tag("div", html, ground)


def chip(text: str, ground: str, ink: str) -> str:
    """A short text on a ground of a colour."""
    look = f"background:{ground};color:{ink};border-radius:4px;padding:.1em .5em"
    return _tag("b", text, look, ONE_LINE)


def mark(sign: str, colour: str) -> str:
    """A sign of a colour, such as a dot."""
    return _tag("b", sign, f"color:{colour}")


def minus(text: str) -> str:
    """A number's text with a true minus."""
    return text.replace("-", "−")


def _tag(name: str, html: str, *styles: str) -> str:
    return f"<{name}{_style(*styles)}>{html}</{name}>"


def _style(*styles: str) -> str:
    declared = ";".join(style for style in styles if style)
    return f' style="{declared}"' if declared else ""
