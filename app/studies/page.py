"""`index.html`: all figures and claims on one page that needs nothing else."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any, NamedTuple

_UNITS = {
    "_m4prad4": "m⁴/rad⁴",
    "_radps2": "rad/s²",
    "_mps2": "m/s²",
    "_per_m2": "1/m²",
    "_per_m": "1/m",
    "_rad": "rad",
    "_nm": "N m",
    "_us": "µs",
    "_m": "m",
    "_n": "N",
    "_s": "s",
    "_radps": "rad/s",
    "_mps": "m/s",
}
"""Endings of keys; longer ones first where one ends in another."""

_STYLE = """
:root { color-scheme: light; --ink: #1f2933; --soft: #616e7c; --line: #e4e7eb; }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 1180px; padding: 2.5rem 1.5rem 4rem; color: var(--ink);
  font: 16px/1.55 system-ui, sans-serif; background: #fff; }
h1 { font-size: 1.9rem; line-height: 1.2; margin: 0 0 .4rem; }
h2 { font-size: 1.25rem; margin: 3rem 0 .8rem; }
h3 { font-size: .8rem; letter-spacing: .06em; text-transform: uppercase; color: var(--soft);
  margin: 0 0 .4rem; }
.lead { color: var(--soft); max-width: 46rem; }
nav a { display: inline-block; margin: 0 .9rem .2rem 0; color: #0072b2; text-decoration: none; }
table { border-collapse: collapse; width: 100%; font-size: .9rem; }
th, td { text-align: left; vertical-align: top; padding: .45rem .7rem .45rem 0;
  border-bottom: 1px solid var(--line); }
td.number { font-variant-numeric: tabular-nums; white-space: nowrap; }
img { width: 100%; height: auto; display: block; border: 1px solid var(--line);
  border-radius: 6px; }
.sides { display: grid; grid-template-columns: 2fr 3fr; gap: 2.2rem; margin-top: 1.1rem; }
.yes, .no { font-weight: 600; white-space: nowrap; }
.yes { color: #00664a; } .no { color: #b3261e; }
.source { color: var(--soft); font-size: .78rem; }
.scroll { overflow-x: auto; }
@media (max-width: 760px) { .sides { grid-template-columns: 1fr; } }
"""


class Section(NamedTuple):
    """One figure on the page.

    Attributes:
        name: As the command calls it.
        title: Its number in the paper and what it shows.
        png: The picture.
        paper: What the paper says about it, in our words.
        measured: What was measured here; keys end in their unit.
        remarks: One sentence each.
        files: Names of its files.
    """

    name: str
    title: str
    png: bytes
    paper: str
    measured: Mapping[str, Any]
    remarks: Sequence[str]
    files: Sequence[str]


def page_html(sections: Sequence[Section], claims: Sequence[Mapping[str, Any]], about: str) -> str:
    """The page.

    Args:
        sections: The figures.
        claims: Rows of the table of claims, as `claims.judge` gives them.
        about: One sentence about what was run.
    """
    hold = sum(bool(claim["holds"]) for claim in claims)
    links = "".join(
        f'<a href="#{escape(s.name)}">{escape(s.title.split(":")[0])}</a>' for s in sections
    )
    tally = f"{hold} of {len(claims)} claims hold here. " if claims else ""
    return document(
        "The paper's experiments, reproduced",
        "<p class='lead'>Reactive Self-Collision Avoidance for a Differentially Driven Mobile "
        f"Manipulator, in simulation. {tally}{escape(about)}</p>\n<nav>{links}</nav>\n"
        + (_claims(claims) if claims else "")
        + "".join(map(_section, sections)),
    )


def document(title: str, body: str) -> str:
    """A page that needs nothing else.

    Args:
        title: Plain text, also its heading.
        body: HTML.
    """
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{_STYLE}</style>\n</head>\n"
        f"<body>\n<h1>{escape(title)}</h1>\n{body}</body>\n</html>\n"
    )


def picture_html(text: str, png: bytes) -> str:
    """A picture that stands in the page itself; `text` for those who do not see it."""
    data = b64encode(png).decode("ascii")
    return f'<img alt="{escape(text)}" src="data:image/png;base64,{data}">\n'


def label(key: str) -> str:
    """A key as people read it, its unit in brackets."""
    for ending, unit in _UNITS.items():
        if key.endswith(ending) and len(key) > len(ending):
            return f"{key.removesuffix(ending).replace('_', ' ')} [{unit}]"
    return key.replace("_", " ")


def _claims(claims: Sequence[Mapping[str, Any]]) -> str:
    rows = "".join(
        f"<tr><td>§{escape(c['section'])}</td><td>{escape(c['paper'])}</td>"
        f"<td>{escape(c['measured'])}{_limits(c['limits'])}</td>"
        f"<td>{_verdict(c['holds'])}</td></tr>\n"
        for c in claims
    )
    return (
        '<h2>What the paper claims</h2>\n<div class="scroll"><table>\n'
        "<tr><th></th><th>The paper says</th><th>Measured here</th><th>Holds</th></tr>\n"
        f"{rows}</table></div>\n"
    )


def _limits(limits: Sequence[Mapping[str, Any]]) -> str:
    """Where the numbers come from against which the measured ones were held."""
    lines = (f"{x['value']:g} {x['unit']}".strip() + f": {x['source']}" for x in limits)
    return "".join(f'<br><span class="source">{escape(line)}</span>' for line in lines)


def _verdict(holds: bool) -> str:
    return '<span class="yes">✓ holds</span>' if holds else '<span class="no">✗ does not</span>'


def _section(section: Section) -> str:
    remarks = "".join(f"<p>{escape(remark)}</p>" for remark in section.remarks)
    return (
        f'<h2 id="{escape(section.name)}">{escape(section.title)}</h2>\n'
        f"{picture_html(section.title, section.png)}"
        f'<div class="sides"><div><h3>The paper says</h3><p>{escape(section.paper)}</p></div>\n'
        f'<div><h3>Measured here</h3><div class="scroll">{measured_html(section.measured)}</div>'
        f'{remarks}<p class="lead">{escape(", ".join(section.files))}</p></div></div>\n'
    )


def measured_html(measured: Mapping[str, Any]) -> str:
    """A table of figures; cases with figures of their own stand side by side."""
    plain = {k: v for k, v in measured.items() if not isinstance(v, Mapping)}
    cases = {k: v for k, v in measured.items() if isinstance(v, Mapping)}
    rows = "".join(_row(label(key), [value]) for key, value in _flat(plain).items())
    tables = f"<table>{rows}</table>" if rows else ""
    if cases:
        columns = {name: _flat(case) for name, case in cases.items()}
        keys = dict.fromkeys(key for column in columns.values() for key in column)
        head = "".join(f"<th>{escape(name)}</th>" for name in columns)
        body = "".join(
            _row(label(key), [column.get(key) for column in columns.values()]) for key in keys
        )
        tables += f"<table><tr><th></th>{head}</tr>{body}</table>"
    return tables


def _flat(values: Mapping[str, Any]) -> dict[str, Any]:
    """Nested figures under joined keys."""
    flat: dict[str, Any] = {}
    for key, value in values.items():
        if isinstance(value, Mapping):
            flat |= {f"{key}, {inner}": v for inner, v in value.items()}
        else:
            flat[key] = value
    return flat


def _row(name: str, values: Sequence[Any]) -> str:
    cells = "".join(f'<td class="number">{escape(_text(value))}</td>' for value in values)
    return f"<tr><td>{escape(name)}</td>{cells}</tr>"


def _text(value: Any) -> str:
    if value is None:
        return "never"
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, (list, tuple)):
        return ", ".join(map(_text, value))
    return f"{value:,}" if isinstance(value, int) else str(value)
