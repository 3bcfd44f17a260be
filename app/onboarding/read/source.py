"""A URDF or xacro file as XML, from a path or an installed package."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from app.errors import AssetError, RobotFileError
from app.onboarding.read.xml_safety import refuse_entities
from app.robot.assets import package_roots, resolve_package_uri, share_folders


def locate(source: str) -> Path:
    """The file of a path or a `package://…` address.

    Raises:
        RobotFileError: There is no such file.
        AssetError: The package is not installed.
    """
    path = resolve_package_uri(source) if source.startswith("package://") else Path(source)
    if not path.is_file():
        raise RobotFileError(
            f"{source}: no such file; give a URDF, a xacro, a zip or package://PACKAGE/…"
        )
    return path.resolve()


def read_source(path: Path) -> Element:
    """The `<robot>` of a URDF or xacro file.

    Raises:
        RobotFileError: It is not well-formed XML, declares entities, is not a robot, or its macros
            cannot be expanded.
    """
    try:
        text = _expanded(path) if path.suffix == ".xacro" else path.read_text(encoding="utf-8")
        refuse_entities(text, path)
        robot = ElementTree.fromstring(text)
    except (ElementTree.ParseError, UnicodeDecodeError) as error:
        raise RobotFileError(f"{path}: not well-formed: {error}") from None
    if robot.tag != "robot":
        raise RobotFileError(f"{path}: its root is <{robot.tag}>, a URDF's is <robot>")
    return robot


def mesh_address(reference: str, folder: Path) -> str:
    """How a description refers to a mesh that a URDF names: by package if it is in one.

    Args:
        reference: What the URDF says.
        folder: The URDF's own folder.

    Returns:
        A `package://…` address of an installed package, else an absolute path.

    Raises:
        RobotFileError: There is no such file.
    """
    if reference.startswith(("package://", "model://")):
        path = _in_packages(reference.partition("://")[2], folder, reference)
    else:
        path = Path(reference.removeprefix("file://"))
        path = path if path.is_absolute() else folder / path
    if not path.is_file():
        raise RobotFileError(f"mesh {reference}: there is no file {path}")
    return installed_address(path) or str(path.resolve())


def mesh_path(address: str) -> Path:
    """The file behind what `mesh_address` gave."""
    return resolve_package_uri(address) if address.startswith("package://") else Path(address)


def installed_address(path: Path) -> str | None:
    """`package://…` of a file that belongs to an installed package, or None."""
    full = path.resolve()
    for share in share_folders():
        if full.is_relative_to(share.resolve()):
            return f"package://{full.relative_to(share.resolve()).as_posix()}"
    for parent in full.parents:
        roots = [root.resolve() for root in package_roots(parent.name)] if parent.name else []
        if parent in roots:
            return f"package://{parent.name}/{full.relative_to(parent).as_posix()}"
    return None


def _in_packages(inner: str, folder: Path, reference: str) -> Path:
    """The file of a package: an installed one, or a folder of that name around the URDF."""
    try:
        return resolve_package_uri(f"package://{inner}")
    except AssetError as error:
        package, _, rest = inner.partition("/")
        for parent in (folder, *folder.parents):
            for root in (parent, parent / package):
                if root.name == package and (root / rest).is_file():
                    return root / rest
        raise RobotFileError(f"mesh {reference}: {_reason(error)}") from None


def _reason(error: AssetError) -> str:
    return re.sub(r"^package://\S+: ", "", str(error))


def _expanded(path: Path) -> str:
    """A xacro file's URDF; packages are looked for around the file and among the installed ones."""
    try:
        from xacrodoc import XacroDoc, packages
    except ImportError:
        raise RobotFileError(
            f"{path}: a xacro needs the package xacrodoc; try: pip install 'xacrodoc>=2,<3'"
        ) from None
    refuse_entities(path.read_bytes(), path)
    packages.update_package_cache(_around(path))
    try:
        document = XacroDoc.from_file(str(path), resolve_packages=False)
    except Exception as error:  # xacro has no common base of its errors
        why = " ".join(str(error).split())
        raise RobotFileError(f"{path}: xacro cannot expand it: {why}") from None
    return document.to_urdf_string()


def _around(path: Path) -> dict[str, str]:
    """Folders that may be the packages a xacro names: those beside any folder above it."""
    found: dict[str, str] = {}
    for parent in list(path.parents)[1:5]:
        for folder in sorted(parent.iterdir()):
            if folder.is_dir() and not folder.name.startswith((".", "_")):
                found.setdefault(folder.name, str(folder))
    for share in share_folders():
        found |= {each.name: str(each) for each in share.iterdir() if each.is_dir()} | found
    return found
