"""The page on the method indexes every equation; the page on descriptions, every field."""

from __future__ import annotations

import ast
import importlib
import inspect
import pkgutil
import re
from collections.abc import Iterator
from types import FunctionType
from typing import NamedTuple

import pytest

import app
from app.robot.bases.differential import DifferentialBase
from app.robot.description import (
    ArmDescription,
    BodyDescription,
    LinePlace,
    ReachabilityDescription,
    RobotDescription,
)
from app.robot.shapes import Box, Capsule, ConvexMesh, Cylinder, Hull, Sphere
from tests.readme import PROJECT, page, section

EQUATIONS = range(1, 30)
MARK = re.compile(r"^\s*Paper: Eq\. ((?:\(\d+\)(?:, )?)+)", re.MULTILINE)


class Line(NamedTuple):
    """One line of the index."""

    equations: frozenset[int]
    function: str
    test: str


def numbers(text: str) -> frozenset[int]:
    """The equation numbers in a text such as `(5), (6)`."""
    return frozenset(int(n) for n in re.findall(r"\((\d+)\)", text))


def index() -> list[Line]:
    """The lines of the table "Where each equation is"."""
    rows = re.findall(
        r"^\| (\(.*?\)) \| `(.*?)` \| `(.*?)` \|$",
        section("Where each equation is", page("method")),
        re.M,
    )
    return [Line(numbers(equations), function, test) for equations, function, test in rows]


def named(path: str) -> object:
    """The object of a dotted path: a function, a class or a method."""
    parts = path.split(".")
    for split in range(len(parts) - 1, 0, -1):
        try:
            found: object = importlib.import_module(".".join(parts[:split]))
        except ModuleNotFoundError:
            continue
        for name in parts[split:]:
            found = getattr(found, name)
        return found
    raise ModuleNotFoundError(path)


def marked(thing: object) -> frozenset[int]:
    """The equations that an object's own docstring says it implements."""
    return numbers(" ".join(MARK.findall(inspect.getdoc(thing) or "")))


def public_functions() -> Iterator[tuple[str, object]]:
    """All public functions, classes, methods and properties outside of dashboard and CLI."""
    for info in pkgutil.walk_packages(app.__path__, "app."):
        if info.name.split(".")[1] in {"dashboard", "cli", "__main__"}:
            continue
        module = importlib.import_module(info.name)
        for name, thing in vars(module).items():
            if name.startswith("_") or getattr(thing, "__module__", None) != info.name:
                continue
            if inspect.isfunction(getattr(thing, "py_func", thing)) or inspect.isclass(thing):
                yield f"{info.name}.{name}", thing
            if inspect.isclass(thing):
                for method, body in vars(thing).items():
                    if not method.startswith("_") and isinstance(body, FunctionType | property):
                        yield f"{info.name}.{name}.{method}", body


def test_the_index_has_every_equation() -> None:
    assert frozenset().union(*(line.equations for line in index())) == frozenset(EQUATIONS)


@pytest.mark.parametrize("line", index(), ids=lambda line: line.function)
def test_function_in_the_index_names_its_equations(line: Line) -> None:
    function = named(line.function)
    assert callable(function) or isinstance(function, property)
    assert line.equations <= marked(function)


@pytest.mark.parametrize("line", index(), ids=lambda line: line.test)
def test_test_in_the_index_exists_and_asserts(line: Line) -> None:
    file, _, name = line.test.partition("::")
    tree = ast.parse((PROJECT / "tests" / file).read_text(encoding="utf-8"))
    (test,) = [n for n in tree.body if isinstance(n, ast.FunctionDef) and n.name == name]
    asserts = [n for n in ast.walk(test) if isinstance(n, ast.Assert)]
    calls = {ast.unparse(n.func) for n in ast.walk(test) if isinstance(n, ast.Call)}
    assert asserts or any(".assert_" in call for call in calls)


def test_index_lists_every_public_function_with_an_equation() -> None:
    listed = {(line.function, n) for line in index() for n in line.equations}
    found = {(path, n) for path, thing in public_functions() for n in marked(thing)}
    assert found == listed


def test_method_page_prints_every_equation_once_and_in_order() -> None:
    assert [int(n) for n in re.findall(r"\\tag\{(\d+)\}", page("method"))] == list(EQUATIONS)


@pytest.mark.parametrize(
    ("heading", "record"),
    [
        ("top", RobotDescription),
        ("`[base]`", DifferentialBase),
        ("`[arm]`", ArmDescription),
        ("`[[bodies]]`", BodyDescription),
        ("`[reachability.BODY]`", ReachabilityDescription),
        ("`[lines.SCENARIO]`", LinePlace),
    ],
)
def test_every_field_of_a_description_is_documented(heading: str, record: type) -> None:
    (row,) = re.findall(rf"^\| {re.escape(heading)} \| (.*) \|$", page("robot_toml"), re.M)
    words = set(re.findall(r"[A-Za-z_]\w*", " ".join(re.findall(r"`([^`]*)`", row))))
    tables = {"base", "arm", "bodies", "reachability", "lines", "unwatched", "config"}
    tables |= {"without_line"}
    fields = set(record.model_fields) - (tables if record is RobotDescription else {"source"})
    if record is BodyDescription:
        shapes = (Box, Sphere, Cylinder, Capsule, ConvexMesh, Hull)
        fields |= {s.model_fields["type"].annotation.__args__[0] for s in shapes}
    assert fields <= words
