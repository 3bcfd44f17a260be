"""Sphinx: `make docs` builds these pages into out/docs."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from docutils import nodes

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import app

for _name in getattr(
    app, "__all__", ()
):  # autodoc lists present attributes only, not those that are loaded on demand
    setattr(app, _name, getattr(app, _name))

project = "dbb-mobile-manipulator"
version = release = app.__version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.mathjax"]
html_theme = "furo"
html_title = "Reactive self-collision avoidance for a mobile manipulator"

myst_enable_extensions = ["dollarmath"]
myst_fence_as_directive = ["math"]
myst_heading_anchors = 3

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
napoleon_use_rtype = False
napoleon_use_ivar = True

nitpicky = True
# Types of other modules and libraries have no page here; links between pages are checked.
nitpick_ignore_regex = [(r"py:.*", r".*")]

_LONG_SIGNATURE = 300  # [-] characters


def _number_equations(_: Any, doctree: nodes.document) -> None:
    r"""Put an equation with a \tag of its own into the one environment that takes it."""
    for block in doctree.findall(nodes.math_block):
        if r"\tag{" in block.astext():
            block["no-wrap"] = block["nowrap"] = True  # as Sphinx calls it since 8.2, and before
            block.children = [
                nodes.Text(f"\\begin{{equation}}\n{block.astext()}\n\\end{{equation}}")
            ]


def _skip_machinery(_app: Any, _what: str, name: str, member: object, *_: Any) -> bool | None:
    """Leave out pydantic's settings, and a NamedTuple's fields: its docstring describes them."""
    alias = (getattr(member, "__doc__", None) or "").startswith("Alias for field")
    return True if alias or name == "model_config" else None


def _shorten_signature(*given: Any) -> tuple[str, Any] | None:
    """Leave out the signature of a record with dozens of fields, which follow one by one."""
    signature, returned = given[-2:]
    return ("(...)", returned) if len(signature or "") > _LONG_SIGNATURE else None


def setup(sphinx: Any) -> None:
    """Called by Sphinx."""
    sphinx.connect("doctree-read", _number_equations)
    sphinx.connect("autodoc-skip-member", _skip_machinery)
    sphinx.connect("autodoc-process-signature", _shorten_signature)
