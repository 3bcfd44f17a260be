"""The README says what is so: its index of equations, its loop, its commands, its links."""

from __future__ import annotations

import ast
import importlib
import inspect
import pkgutil
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

import app
from app.border.cache import BorderData
from app.config import Config
from app.robot.description import (
    ArmDescription,
    BaseDescription,
    BodyDescription,
    ReachabilityDescription,
    RobotDescription,
)
from app.robot.model import RobotModel
from app.robot.shapes import Box, Capsule, ConvexMesh, Cylinder, Sphere
from app.robot.state import RobotState
from app.simulation.start import StartSolver

PROJECT = Path(__file__).resolve().parent.parent
README = (PROJECT / "README.md").read_text(encoding="utf-8")
EQUATIONS = range(1, 30)
MARK = re.compile(r"^\s*Paper: Eq\. ((?:\(\d+\)(?:, )?)+)", re.MULTILINE)


class Line(NamedTuple):
    """One line of the index."""

    equations: frozenset[int]
    function: str
    test: str


def section(title: str) -> str:
    """The text below a heading of any depth, up to the next heading."""
    found = re.search(rf"^#+ {re.escape(title)}$(.*?)(?=^#+ |\Z)", README, re.M | re.S)
    assert found, f"the README has no section {title!r}"
    return found[1]


def numbers(text: str) -> frozenset[int]:
    """The equation numbers in a text such as `(5), (6)`."""
    return frozenset(int(n) for n in re.findall(r"\((\d+)\)", text))


def index() -> list[Line]:
    """The lines of the table "Where each equation is"."""
    rows = re.findall(
        r"^\| (\(.*?\)) \| `(.*?)` \| `(.*?)` \|$", section("Where each equation is"), re.M
    )
    return [Line(numbers(equations), function, test) for equations, function, test in rows]


def named(path: str) -> object:
    """What a dotted path names: a function, a class or a method."""
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
    """All public functions, classes and methods of `app` below the screen, by their dotted paths."""
    for info in pkgutil.walk_packages(app.__path__, "app."):
        if info.name.split(".")[1] in {"dashboard", "cli", "__main__"}:
            continue
        module = importlib.import_module(info.name)
        for name, thing in vars(module).items():
            if name.startswith("_") or getattr(thing, "__module__", None) != info.name:
                continue
            if inspect.isfunction(thing) or inspect.isclass(thing):
                yield f"{info.name}.{name}", thing
            if inspect.isclass(thing):
                for method, body in vars(thing).items():
                    if not method.startswith("_") and inspect.isfunction(body):
                        yield f"{info.name}.{name}.{method}", body


def test_the_index_has_every_equation() -> None:
    assert frozenset().union(*(line.equations for line in index())) == frozenset(EQUATIONS)


@pytest.mark.parametrize("line", index(), ids=lambda line: line.function)
def test_a_function_of_the_index_says_which_equation_it_is(line: Line) -> None:
    function = named(line.function)
    assert callable(function)
    assert line.equations <= marked(function)


@pytest.mark.parametrize("line", index(), ids=lambda line: line.test)
def test_a_test_of_the_index_exists(line: Line) -> None:
    file, _, name = line.test.partition("::")
    tree = ast.parse((PROJECT / "tests" / file).read_text(encoding="utf-8"))
    (test,) = [n for n in tree.body if isinstance(n, ast.FunctionDef) and n.name == name]
    asserts = [n for n in ast.walk(test) if isinstance(n, ast.Assert)]
    calls = {ast.unparse(n.func) for n in ast.walk(test) if isinstance(n, ast.Call)}
    assert asserts or any(".assert_" in call for call in calls)


def test_every_public_function_that_is_an_equation_stands_in_the_index() -> None:
    listed = {(line.function, n) for line in index() for n in line.equations}
    found = {(path, n) for path, thing in public_functions() for n in marked(thing)}
    assert found == listed


def test_the_method_prints_every_equation_once_and_in_order() -> None:
    assert [int(n) for n in re.findall(r"\\tag\{(\d+)\}", section("The method"))] == list(EQUATIONS)


def run_loop(**changes: tuple[str, str]) -> dict[str, Any]:
    """The names that the README's loop leaves behind; each change is (old text, new text)."""
    (code,) = re.findall(r"^```python\n(.*?)^```", README, re.M | re.S)
    for old, new in changes.values():
        assert code.count(old) == 1
        code = code.replace(old, new)
    names: dict[str, Any] = {}
    exec(compile(code, "README.md", "exec"), names)
    return names


def test_the_loop_of_the_readme_runs_and_holds_the_arm() -> None:
    """Gravity compensation without a person: nothing moves, and no QP fails."""
    names = run_loop()
    measured = names["robot"].measure()
    ready = np.array(names["model"].description.arm.ready_position)
    np.testing.assert_allclose(measured.q_m, ready, atol=1e-6)
    np.testing.assert_allclose(measured.base_pose, 0.0, atol=1e-9)
    state = RobotState(names["model"])
    state.update(measured)
    assert np.abs(state.g[2:]).max() > 1.0  # [N m] there is something to hold
    np.testing.assert_allclose(names["output"].u_a, state.g[2:], atol=1e-4)
    assert names["controller"].failures == 0


@pytest.mark.parametrize(("controller", "moves"), [("dbb", True), ("none", False)])
def test_in_the_loop_of_the_readme_the_base_gives_way_to_a_pulled_hand(
    robot: RobotModel, border_data: BorderData, controller: str, moves: bool
) -> None:
    """The same lines with a person who pulls the hand from the front towards the base."""
    q_start = StartSolver(robot, border_data.pairs, Config().border.d_b).solve((0.92, 0.10, 0.30))
    names = run_loop(
        start=("for _ in", f"robot.reset([0.0, 0.0, 0.0], {q_start.tolist()})\nfor _ in"),
        pull=("hand_force=[0.0, 0.0, 0.0]", "hand_force=[-15.0, 0.0, 0.0]"),
        name=("border_data(model), config)", f"border_data(model), config, name={controller!r})"),
    )
    assert (names["robot"].measure().base_pose[0] < -0.02) == moves  # [m]


def examples() -> list[str]:
    """The examples of the section on commands."""
    return re.findall(r"^\| `dbb .*\| `(dbb .*?)` \|$", section("Commands"), re.M)


@pytest.mark.parametrize("example", examples())
def test_every_option_of_an_example_is_one_of_its_command(example: str) -> None:
    _, command, *rest = example.split()
    done = subprocess.run(
        [sys.executable, "-m", "app", command, "--help"],
        cwd=PROJECT, capture_output=True, text=True, check=True,
    )  # fmt: skip
    for option in (word for word in rest if word.startswith("--")):
        assert re.search(rf"{option}\b", done.stdout), option


def test_there_is_an_example_of_every_command() -> None:
    assert {example.split()[1] for example in examples()} == {
        "serve", "run", "pairs", "border", "robots",
    }  # fmt: skip


def test_every_file_that_the_readme_names_exists() -> None:
    linked = re.findall(r"\]\(([^)#:]+)\)", README)
    spoken = re.findall(r"`((?:app|tests|robot_assets|dbb_cache)/[\w./]*)`", README)
    assert "docs/dashboard.png" in linked
    missing = [name for name in {*linked, *spoken} if not (PROJECT / name).exists()]
    assert [name for name in missing if "NAME" not in name] == []


@pytest.mark.parametrize(
    ("heading", "record"),
    [
        ("top", RobotDescription),
        ("`[base]`", BaseDescription),
        ("`[arm]`", ArmDescription),
        ("`[[bodies]]`", BodyDescription),
        ("`[reachability.BODY]`", ReachabilityDescription),
    ],
)
def test_every_field_of_a_description_is_in_the_readme(heading: str, record: type) -> None:
    (row,) = re.findall(rf"^\| {re.escape(heading)} \| (.*) \|$", section("Another robot"), re.M)
    words = set(re.findall(r"[A-Za-z_]\w*", " ".join(re.findall(r"`([^`]*)`", row))))
    tables = {"base", "arm", "bodies", "reachability"}
    fields = set(record.model_fields) - (tables if record is RobotDescription else {"source"})
    if record is BodyDescription:
        shapes = (Box, Sphere, Cylinder, Capsule, ConvexMesh)
        fields |= {s.model_fields["type"].annotation.__args__[0] for s in shapes}
    assert fields <= words
