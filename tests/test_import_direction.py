"""Data flows in one direction: a module imports only from its own layer and earlier layers."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TypeGuard

import pytest

PROJECT = Path(__file__).resolve().parent.parent

LAYERS = (
    "errors",
    "system",
    "jobs",
    "strict",
    "kernel_store",
    "compiled",
    "structs",
    "config",
    "config_file",
    "robot",
    "border",
    "avoidance",
    "control",
    "simulation",
    "studies",
    "onboarding",
    "dashboard",
    "cli",
    "__main__",
)
"""Packages and single modules in the order of the data flow."""

CORE = ("robot", "border", "avoidance", "control")
"""The method, which imports no simulator, dashboard or files of results."""

ONLY_IN = {
    "viser": {"dashboard"},
    "playwright": {"dashboard"},
    "mujoco": {"simulation"},
    "pybullet": {"simulation"},
    "pybullet_data": {"simulation"},
    "tyro": {"cli"},
    "distributed": {"studies"},
    "pyarrow": {"studies"},
    "jinja2": {"studies"},
    "matplotlib": {"studies", "onboarding"},
    "mpl_toolkits": {"studies"},
}
"""Libraries that only some layers may import."""

ONE_FOLDER = {"pyarrow": "simulation/trace/"}
"""The one folder outside these layers that may import a library: a log is a Parquet file, and the
dashboard writes logs without the libraries of a study."""


FILES = sorted((PROJECT / "app").rglob("*.py"))


def test_every_module_is_in_a_known_layer() -> None:
    assert len(FILES) > len(LAYERS)
    assert {layer_of(path) for path in FILES} <= {*LAYERS, "__init__"}
    assert {layer_of(path) for path in FILES} >= set(LAYERS)


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(PROJECT)))
def test_a_module_imports_only_from_its_own_and_earlier_layers(path: Path) -> None:
    source = path.read_text(encoding="utf-8")
    here = path.relative_to(PROJECT / "app").as_posix()
    excused = {library for library, folder in ONE_FOLDER.items() if here.startswith(folder)}
    assert set(violations(source, layer_of(path), package_of(path))) <= excused


@pytest.mark.parametrize(
    ("layer", "source", "culprit"),
    [
        ("robot", "import app.border.dbb", "app.border.dbb"),
        ("border", "from app.control.tasks import activation", "app.control.tasks"),
        ("avoidance", "from app import control", "app.control"),
        ("control", "def f():\n    from ..simulation import person", "app.simulation"),
        ("config", "from . import robot", "app.robot"),
        ("control", "import importlib\nimportlib.import_module('app.cli.run')", "app.cli.run"),
        ("simulation", "import viser.transforms", "viser"),
        ("cli", "import viser", "viser"),
        ("control", "import pybullet as p", "pybullet"),
        ("dashboard", "import pybullet_data", "pybullet_data"),
        ("border", "import app", "app"),
        ("simulation", "import pyarrow.csv", "pyarrow"),
    ],
)
def test_the_rule_detects_every_forbidden_import(layer: str, source: str, culprit: str) -> None:
    package = "app" if layer == "config" else f"app.{layer}"
    assert violations(source, layer, package) == [culprit]


SCREEN = re.compile(
    r"</?(su[bp]|b|br|i|p|div|span|t[dr])\b|[a-z]_(mps2?|radps2?|rad|nm)$|\w[a-z]_n$|\bHTML\b"
)
"""Markup of a page and names of a log's columns, but not the point p_n."""


def test_the_core_has_no_markup_and_no_column_names() -> None:
    found = [
        f"{path.relative_to(PROJECT)}: {node.value}"
        for path in FILES
        if layer_of(path) in CORE
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if is_text(node) and SCREEN.search(node.value)
    ]
    assert found == []


@pytest.mark.parametrize(
    "text", ["det(J<sub>c</sub>)", "vx_mps", "aw_radps2", "hand_force_n", "Of it, as HTML."]
)
def test_the_pattern_detects_markup_and_column_names(text: str) -> None:
    assert SCREEN.search(text)


def is_text(node: ast.AST) -> TypeGuard[ast.Constant]:
    """Whether a node is a string constant."""
    return isinstance(node, ast.Constant) and isinstance(node.value, str)


def layer_of(path: Path) -> str:
    """The first part of a module's name below `app`."""
    return path.relative_to(PROJECT / "app").parts[0].removesuffix(".py")


def package_of(path: Path) -> str:
    """The package to which a file's relative imports refer."""
    return ".".join(path.relative_to(PROJECT).parent.parts)


def violations(source: str, layer: str, package: str) -> list[str]:
    """Forbidden imports of a module in a layer."""
    return [name for name in imported(ast.parse(source), package) if not allowed(name, layer)]


def allowed(name: str, layer: str) -> bool:
    """Whether a layer may import a module."""
    top, _, rest = name.partition(".")
    if top == "app":
        other = rest.partition(".")[0]
        if layer == "__init__":
            return other in LAYERS[: LAYERS.index("simulation")]
        # `import app` alone gives access to every layer.
        return other in LAYERS and LAYERS.index(other) <= LAYERS.index(layer)
    return layer in ONLY_IN.get(top, {layer})


def imported(tree: ast.AST, package: str) -> Iterator[str]:
    """Full names of the imported modules, in any place and form of import."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (top_of_library(alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = resolved(node, package)
            if base == "app":  # from app import control
                yield from (f"app.{alias.name}" for alias in node.names)
            else:
                yield top_of_library(base)
        elif isinstance(node, ast.Call) and called_name(node) in {"import_module", "__import__"}:
            first = node.args[0] if node.args else None
            if isinstance(first, ast.Constant) and isinstance(first.value, str):
                yield top_of_library(first.value)


def resolved(node: ast.ImportFrom, package: str) -> str:
    """The module of a `from … import`, its leading dots resolved."""
    if not node.level:
        return node.module or ""
    parents = package.split(".")
    base = ".".join(parents[: len(parents) - node.level + 1])
    return f"{base}.{node.module}" if node.module else base


def top_of_library(name: str) -> str:
    """A library by its first name, the project's own modules in full."""
    return name if name.split(".")[0] == "app" else name.split(".")[0]


def called_name(node: ast.Call) -> str:
    """The last part of the name of a called function."""
    return getattr(node.func, "attr", getattr(node.func, "id", ""))
