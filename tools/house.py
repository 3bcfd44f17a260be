"""Measures of the code's structure, with their limits: `python -m tools.house [--names] [--json]`.

The status is 1 if a measure exceeds its limit, except with `--json`. The limit of the lines of
`app` is near their present number, so that a change that adds many lines must remove others.
"""

from __future__ import annotations

import argparse
import ast
import json
import sys
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from pathlib import Path
from types import FrameType, FunctionType
from typing import Any, NamedTuple
from unittest.mock import patch

PROJECT = Path(__file__).resolve().parent.parent
APP = PROJECT / "app"
FORMATTED = ("app", "tests", "tools", "benchmarks", "examples", "docs")
LONG = 60  # [-] lines of a function
MANY = 10  # [-] parameters of a function

Imports = Mapping[str, frozenset[str]]


class Measure(NamedTuple):
    """One line of the table.

    Attributes:
        what: The counted items.
        value: The present count.
        limit: The largest accepted count.
    """

    what: str
    value: int
    limit: int

    @property
    def beyond(self) -> bool:
        """Whether the value exceeds the limit."""
        return self.value > self.limit


@cache
def trees() -> dict[str, ast.Module]:
    """The syntax trees of all modules of `app`, by their dotted names."""
    return {
        ".".join(path.relative_to(PROJECT).with_suffix("").parts).removesuffix(".__init__"): (
            ast.parse(path.read_text(encoding="utf-8"))
        )
        for path in sorted(APP.rglob("*.py"))
    }


def imports_of(name: str, tree: ast.Module, known: frozenset[str]) -> frozenset[str]:
    """The modules of `known` that a module imports anywhere, including annotations."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level:
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                found.add(inner if inner in known else str(node.module))
    return frozenset(found & known - {name})


def imports() -> Imports:
    """The modules of `app` that each module of `app` imports."""
    known = frozenset(trees())
    return {name: imports_of(name, tree, known) for name, tree in trees().items()}


def single_users(graph: Imports, packages: frozenset[str]) -> list[str]:
    """Modules that exactly one other module imports; packages do not count."""
    users: dict[str, int] = {}
    for found in graph.values():
        for name in found:
            users[name] = users.get(name, 0) + 1
    return sorted(name for name, count in users.items() if count == 1 and name not in packages)


def circles(graph: Imports) -> list[frozenset[str]]:
    """Sets of modules that import each other, directly or through others."""
    reach = {name: _reachable(name, graph) for name in graph}
    found = {
        frozenset(other for other in reach[name] if name in reach[other]) | {name}
        for name in graph
        if name in reach[name]
    }
    return sorted(found, key=sorted)


def _reachable(name: str, graph: Imports) -> set[str]:
    seen: set[str] = set()
    ahead = [*graph[name]]
    while ahead:
        here = ahead.pop()
        if here not in seen:
            seen.add(here)
            ahead += graph[here]
    return seen


def functions() -> Iterator[tuple[str, ast.FunctionDef | ast.AsyncFunctionDef]]:
    """All functions and methods of `app`, by module and name."""
    for module, tree in trees().items():
        for node in ast.walk(tree):
            if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
                yield f"{module}.{node.name}", node


def lines_of(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Lines from `def` to the end, including the docstring."""
    return (function.end_lineno or function.lineno) - function.lineno + 1


def parameters_of(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Number of parameters, without `self`, `cls`, `*args` and `**kwargs`."""
    given = function.args
    names = [a.arg for a in (*given.posonlyargs, *given.args, *given.kwonlyargs)]
    return sum(name not in ("self", "cls") for name in names)


def step_files() -> list[str]:
    """Files of `app` that one control step enters, in order, including those of compiled code.

    A person guides the arm inside the buffer of a pair with the base.
    """
    import numpy as np

    from app.control import controller
    from app.control.controller import ControlLoop
    from app.robot.state import Measurement
    from benchmarks.law.postures import posture_in_buffer
    from benchmarks.law.robot import load

    robot = load("husky_panda")
    q_m = posture_in_buffer(robot, np.random.default_rng(0))
    at_rest = Measurement(np.zeros(3), np.zeros(2), q_m, np.zeros(len(q_m)))
    loop = ControlLoop(robot.model, robot.data)
    loop.step(at_rest)
    compiled = _compiled()
    entered: dict[str, None] = {}

    def note(frame: FrameType, event: str, _: object) -> None:
        if event == "call":
            code = frame.f_code
            kernel = compiled.get((code.co_filename, code.co_name))
            entered.update(dict.fromkeys(_files_of(kernel) if kernel else [code.co_filename]))

    def noting(kernel: Any, code: Callable[..., Any]) -> Callable[..., Any]:
        """Call machine code, which a profiler does not see, and note the files of its kernel."""

        def call(*values: Any) -> Any:
            entered.update(dict.fromkeys(_files_of(kernel.py_func)))
            return code(*values)

        return call

    estimate = noting(controller.algorithm.update_estimate, controller._estimate)
    law = noting(controller.algorithm.run_algorithm_2, controller._law)
    with patch.multiple(controller, _estimate=estimate, _law=law):
        sys.setprofile(note)
        try:
            loop.step(at_rest)
        finally:
            sys.setprofile(None)
    inside = [Path(name) for name in entered if Path(name).is_relative_to(APP)]
    return [path.relative_to(PROJECT).as_posix() for path in inside]


def _compiled() -> dict[tuple[str, str], FunctionType]:
    """The functions that numba has compiled, by file and name.

    A profiler records a call of such a function from Python, but no call inside its machine code.
    """
    from numba.core.dispatcher import Dispatcher

    modules = [module for name, module in sys.modules.items() if name.startswith("app.")]
    things = [thing for module in modules for thing in vars(module).values()]
    functions = [thing.py_func for thing in things if isinstance(thing, Dispatcher)]
    return {(f.__code__.co_filename, f.__code__.co_name): f for f in functions}


def _files_of(kernel: FunctionType) -> list[str]:
    """The files of a compiled function and of those that it calls, in their order."""
    found: dict[FunctionType, None] = {}

    def visit(function: FunctionType) -> None:
        if function in found:
            return
        found[function] = None
        for name in function.__code__.co_names:
            called = getattr(function.__globals__.get(name), "py_func", None)
            if called is not None:
                visit(called)

    visit(kernel)
    return list(dict.fromkeys(function.__code__.co_filename for function in found))


def measures(step: list[str]) -> list[Measure]:
    """All measures.

    Args:
        step: The result of `step_files`.
    """
    packages = frozenset(
        ".".join(path.parent.relative_to(PROJECT).parts) for path in APP.rglob("__init__.py")
    )
    graph = imports()
    code = list(APP.rglob("*.py"))
    skipped = sum(
        line.rstrip().endswith("# fmt: skip")
        for folder in FORMATTED
        for path in (PROJECT / folder).rglob("*.py")
        for line in path.read_text(encoding="utf-8").splitlines()
    )
    return [
        Measure("files that one control step enters", len(step), 14),
        Measure("modules of `app`", len(code), 200),
        Measure("lines of `app`", sum(map(_lines, code)), 40_000),
        Measure("modules with a single user", len(single_users(graph, packages)), 40),
        Measure(f"functions over {LONG} lines", sum(lines_of(f) > LONG for _, f in functions()), 0),
        Measure(
            f"functions over {MANY} parameters",
            sum(parameters_of(f) > MANY for _, f in functions()),
            0,
        ),
        Measure("circles of imports", len(circles(graph)), 0),
        Measure("lines marked `# fmt: skip`", skipped, 0),
        Measure("lines of the README", _lines(PROJECT / "README.md"), 220),
    ]


def _lines(path: Path) -> int:
    return len(path.read_text(encoding="utf-8").splitlines())


def offenders() -> Iterator[str]:
    """The functions and circles that the measures count."""
    for name, function in functions():
        if lines_of(function) > LONG:
            yield f"{name}: {lines_of(function)} lines"
        if parameters_of(function) > MANY:
            yield f"{name}: {parameters_of(function)} parameters"
    for circle in circles(imports()):
        yield f"circle: {', '.join(sorted(circle))}"


def main() -> int:
    """Print the measures; returns 1 if one exceeds its limit."""
    parser = argparse.ArgumentParser(prog="python -m tools.house", description=__doc__)
    parser.add_argument("--json", action="store_true", help="print one JSON object; status 0")
    parser.add_argument("--names", action="store_true", help="also list the functions and circles")
    options = parser.parse_args()
    step = step_files()
    found = measures(step)
    if options.json:
        table: list[dict[str, Any]] = [measure._asdict() for measure in found]
        print(json.dumps({"measures": table, "step": step}))
        return 0
    for measure in found:
        mark = "!" if measure.beyond else " "
        print(f"{mark} {measure.value:>7,} of {measure.limit:>7,}  {measure.what}")
    if options.names:
        print(*offenders(), sep="\n")
    return int(any(measure.beyond for measure in found))


if __name__ == "__main__":
    sys.exit(main())
