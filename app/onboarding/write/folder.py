"""A new robot's folder: made beside its place, and put there when it is whole."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from xml.etree import ElementTree

from app.errors import OutputError
from app.onboarding.new_robot import NewRobot
from app.onboarding.read.package import FOLDER
from app.onboarding.write.description_text import description_text
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
