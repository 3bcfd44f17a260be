"""A new robot's folder: made beside its place, and put there when it is whole."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import tomlkit
from tomlkit.items import Table

from app.errors import OutputError
from app.onboarding.new_robot import NewRobot
from app.onboarding.read.package import FOLDER
from app.robot.description import load_description


@contextmanager
def whole_folder(out: Path) -> Iterator[Path]:
    """A temporary folder that becomes `out` at the end of a `with` that raised nothing.

    Raises:
        OutputError: `out` is there already, or cannot be written.
    """
    out = out.resolve()
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise OutputError(f"--out: {out} is there already; remove it or give another")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        made = Path(tempfile.mkdtemp(prefix=f".{out.name}-", dir=out.parent))
    except OSError as error:
        raise OutputError(f"--out: cannot write to {out.parent}: {error.strerror}") from None
    try:
        yield made
        made.chmod(0o755)
        if out.exists():
            out.rmdir()
        made.rename(out)
    finally:
        shutil.rmtree(made, ignore_errors=True)


def write_robot(robot: NewRobot, folder: Path) -> None:
    """The description, its URDF and where its assets come from.

    Args:
        robot: What was made.
        folder: A temporary one.
    """
    (folder / "robot.urdf").write_text(robot.urdf, encoding="utf-8")
    title = f"{robot.content['title']}, from {robot.request.told}"
    text = description_text(robot.content, title)
    (folder / "robot.toml").write_text(text, encoding="utf-8")
    load_description(folder / "robot.toml")
    (folder / "SOURCES.md").write_text(sources_text(robot), encoding="utf-8")


def sources_text(robot: NewRobot) -> str:
    """`SOURCES.md`: which files the robot is made of."""
    request, lines = robot.request, []
    copied = "No mesh is copied: `robot.urdf` names the files of the installed packages."
    for what, path in (("robot", request.told), ("arm", request.arm_urdf)):
        if path is not None:
            lines.append(f"- URDF of the {what}: `{path}`")
    meshes = sorted(set(_meshes(robot.urdf)))
    packages = sorted(
        {
            mesh.partition("://")[2].partition("/")[0]
            for mesh in meshes
            if mesh.startswith("package://")
        }
    )
    if packages:
        lines.append(f"- Meshes of the installed packages: {', '.join(f'`{p}`' for p in packages)}")
    loose = [mesh for mesh in meshes if not mesh.startswith("package://")]
    lines += [f"- Mesh by its path on this machine: `{mesh}`" for mesh in loose if mesh[0] == "/"]
    if any(mesh[0] != "/" for mesh in loose):
        lines.append(f"- Meshes of that package, in the folder `{FOLDER}` beside this file")
        copied = "Meshes of installed packages are not copied."
    licence = request.licence or (
        "Not stated by `--licence`: look it up in the packages before passing this folder on."
    )
    warnings = "\n".join(f"- {warning}" for warning in robot.warnings) or "- none"
    return (
        f"# Where {robot.content['title']} comes from\n\n" + "\n".join(lines) + f"\n\n{copied}\n\n"
        f"Licence: {licence}\n\n## Warnings of `dbb new-robot`\n\n{warnings}\n"
    )


def _meshes(urdf: str) -> list[str]:
    return [str(mesh.get("filename")) for mesh in ElementTree.fromstring(urdf).iter("mesh")]


_HEADER = (
    "Made by `dbb new-robot`. Lengths in metres, angles in radians, masses in kilograms.",
    "Each number is measured, from the URDF, given, chosen, counted or assumed; check what is "
    "assumed.",
)


def description_text(content: Mapping[str, Any], title: str) -> str:
    """The text of `robot.toml`.

    Args:
        content: As `RobotDescription` takes it.
        title: First line of the comment at the top.
    """
    document = tomlkit.document()
    document.add(tomlkit.comment(title))
    for line in _HEADER:
        document.add(tomlkit.comment(line))
    document.add(tomlkit.nl())
    for key, value in content.items():
        if not isinstance(value, (Mapping, list)):
            document.add(key, value)
    for key, value in content.items():
        if isinstance(value, Mapping):
            document.add(key, _table(value))
        elif isinstance(value, list):
            document.add(key, _tables(value))
    return tomlkit.dumps(document)


def _table(content: Mapping[str, Any]) -> Table:
    """A table; a field with a source has the first word of it as a comment."""
    table = tomlkit.table()
    sources = content.get("source", {})
    sources = sources if isinstance(sources, Mapping) else {}
    for key, value in content.items():
        if isinstance(value, Mapping):
            table.add(key, _table(value))
        elif isinstance(value, list) and value and isinstance(value[0], Mapping):
            table.add(key, _tables(value))
        else:
            item = tomlkit.item(list(map(_plain, value)) if isinstance(value, tuple) else value)
            if key in sources:
                item.comment(_kind(sources[key]))
            table.add(key, item)
    return table


def _tables(contents: list[Mapping[str, Any]]) -> Any:
    tables = tomlkit.aot()
    for content in contents:
        tables.append(_table(content))
    return tables


def _plain(value: Any) -> Any:
    return list(map(_plain, value)) if isinstance(value, tuple) else value


def _kind(source: str) -> str:
    """What a source says before its colon; a mixed one in full."""
    return source if ";" in source and len(source) < 80 else source.partition(":")[0]
