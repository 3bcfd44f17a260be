"""The measures of the code's structure count correctly."""

from __future__ import annotations

import ast

import pytest

from tools import house

GRAPH = {
    "app.a": frozenset({"app.b"}),
    "app.b": frozenset({"app.c"}),
    "app.c": frozenset({"app.a", "app.d"}),
    "app.d": frozenset(),
    "app.e": frozenset({"app.d"}),
}


def test_an_indirect_import_cycle_is_found_once() -> None:
    assert house.circles(GRAPH) == [frozenset({"app.a", "app.b", "app.c"})]
    assert house.circles({**GRAPH, "app.c": frozenset({"app.d"})}) == []


def test_only_modules_with_one_user_are_counted_and_no_packages() -> None:
    assert house.single_users(GRAPH, frozenset({"app.c"})) == ["app.a", "app.b"]


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("import app.b", {"app.b"}),
        ("from app import b", {"app.b"}),
        ("from app.b import name", {"app.b"}),
        ("def f():\n    from app.b import name", {"app.b"}),
        ("if TYPE_CHECKING:\n    from app.b import name", {"app.b"}),
        ("import numpy", set()),
    ],
)
def test_every_form_and_place_of_an_import_is_found(source: str, found: set[str]) -> None:
    known = frozenset({"app", "app.a", "app.b"})
    assert house.imports_of("app.a", ast.parse(source), known) - {"app"} == found


def test_counts_exclude_self_variadic_parameters_and_blank_lines() -> None:
    source = "def f(self, a, /, b, *rest, c=1, **others):\n    return a\n\n\nx = 1"
    (function,) = (n for n in ast.walk(ast.parse(source)) if isinstance(n, ast.FunctionDef))
    assert house.parameters_of(function) == 3
    assert house.lines_of(function) == 2


def test_the_files_of_a_control_step_include_the_papers_algorithms() -> None:
    found = house.step_files()
    assert found[0] == "app/control/controller.py"
    assert {"app/control/algorithm.py", "app/control/tasks.py"} <= set(found)
    assert {"app/avoidance/acting_point.py", "app/border/nearest.py"} <= set(found)
    assert len(found) == len(set(found))
    assert not any(name.startswith(("app/simulation", "app/dashboard")) for name in found)
    measures = {measure.what: measure.value for measure in house.measures(found)}
    assert measures["files that one control step enters"] == len(found)
    assert measures["modules of `app`"] == len(list(house.APP.rglob("*.py")))
