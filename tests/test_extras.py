"""A plain installation contains the controller; a command names the extra that it lacks."""

from __future__ import annotations

import ast
import re
import subprocess
import sys

import pytest

from app.errors import EXTRAS, MissingExtraError, extras_named
from tests.test_import_direction import FILES, PROJECT, imported, layer_of, package_of

BASE = {
    "coal",
    "llvmlite",
    "numba",
    "numpy",
    "pinocchio",
    "platformdirs",
    "proxsuite",
    "pydantic",
    "pydantic_core",
    "rich",
    "tomli",
    "tomlkit",
    "typing_extensions",
    "tyro",
}
"""Modules of a plain installation."""

NAMED_OTHERWISE = {
    "collada": "pycollada",
    "fast_simplification": "fast-simplification",
    "foxglove": "foxglove-sdk",
    "google": "protobuf",
    "imageio_ffmpeg": "imageio-ffmpeg",
    "mpl_toolkits": "matplotlib",
    "PIL": "pillow",
    "pybullet_data": "pybullet",
    "dask": "distributed",
    "msgspec": "viser",
    "websockets": "viser",
}
"""Packages of modules with another name."""

OURS = {"app", "benchmarks"}
"""The project's own packages; only a checkout has the second."""


def test_every_imported_library_belongs_to_the_package_or_an_extra() -> None:
    known = BASE | {module for modules in EXTRAS.values() for module in modules.split()} | OURS
    for path in FILES:
        tree = ast.parse(path.read_text(encoding="utf-8"))
        names = {name.partition(".")[0] for name in imported(tree, package_of(path))}
        assert names - sys.stdlib_module_names - {"tomllib"} <= known, path


def test_method_imports_no_extra_at_the_top_of_a_module() -> None:
    for path in FILES:
        if layer_of(path) in {"robot", "border", "avoidance", "control"}:
            tree = ast.parse(path.read_text(encoding="utf-8"))
            top = ast.Module(list(tree.body), [])
            for node in ast.walk(tree):
                if isinstance(node, ast.FunctionDef) or (
                    isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
                ):
                    node.body = []
            names = {name.partition(".")[0] for name in imported(top, package_of(path))}
            assert names - sys.stdlib_module_names - {"tomllib"} <= BASE | {"app"}, path


@pytest.mark.parametrize(("extra", "modules"), EXTRAS.items())
def test_extra_lists_the_packages_of_its_modules(extra: str, modules: str) -> None:
    text = (PROJECT / "pyproject.toml").read_text(encoding="utf-8")
    (packages,) = re.findall(rf"^{extra} = \[\n(.*?)^\]", text, re.M | re.S)
    named = set(re.findall(r'^    "([A-Za-z0-9-]+)', packages, re.M))
    assert {NAMED_OTHERWISE.get(module, module) for module in modules.split()} <= named


@pytest.mark.parametrize(
    ("importer", "module", "extra"),
    [
        ("app.onboarding.report", "matplotlib", "onboarding"),
        ("app.onboarding.read", "trimesh", "onboarding"),
        ("app.dashboard.save", "matplotlib", "studies"),
        ("app.robot.shapes", "trimesh", "sim"),
        ("elsewhere", "viser.transforms", "dashboard"),  # a part of a module of one extra
    ],
)
def test_missing_module_names_the_extra_of_the_importing_package(
    importer: str, module: str, extra: str
) -> None:
    wanted = rf"pip install 'dbb-mobile-manipulator\[{extra}\]'"
    with pytest.raises(MissingExtraError, match=wanted), extras_named():
        exec(f"raise ModuleNotFoundError(name={module!r})", {"__name__": importer})


def test_missing_module_of_no_extra_remains_a_missing_module() -> None:
    with pytest.raises(ModuleNotFoundError, match="elsewhere"), extras_named():
        raise ModuleNotFoundError("elsewhere", name="elsewhere")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "module", "extra"),
    [
        ("serve", "viser", "dashboard"),
        ("reproduce", "matplotlib", "studies"),
        ("run guiding-lateral", "scipy", "sim"),
    ],
)
def test_command_without_its_extra_fails_with_one_line(
    command: str, module: str, extra: str
) -> None:
    code = f"import sys; sys.modules[{module!r}] = None; from app.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code, *command.split()],
        cwd=PROJECT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert done.stderr.strip().splitlines() == [
        f"dbb: error: this needs {module}, which is not installed; "
        f"try: pip install 'dbb-mobile-manipulator[{extra}]'"
    ]
