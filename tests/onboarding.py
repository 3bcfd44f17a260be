"""A small robot as a URDF of boxes and cylinders, built part by part, for tests of onboarding."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import pytest
import trimesh

from app.border.cache import BorderData
from app.border.sampling import SamplingConfig
from app.jobs.progress import OnProgress
from app.onboarding import new_robot, numbers
from app.onboarding.fit import bodies, grouping, meetings, postures
from app.onboarding.fit.postures import Place
from app.robot import assets
from app.robot.model import RobotModel
from app.simulation.scenarios import LINES

INERTIAL = (
    '<inertial><mass value="{m}"/><inertia ixx="{i}" ixy="0" ixz="0" iyy="{i}" iyz="0" izz="{i}"/>'
    "</inertial>"
)


def solid(shape: str, *, mass: float = 1.0, xyz: str = "0 0 0", rpy: str = "0 0 0") -> str:
    """The content of a link: collision shape and inertia."""
    inertial = INERTIAL.format(m=mass, i=0.01 * mass) if mass else ""
    return (
        f'{inertial}<collision><origin xyz="{xyz}" rpy="{rpy}"/><geometry>{shape}</geometry>'
        "</collision>"
    )


def link(name: str, content: str = "") -> str:
    return f'<link name="{name}">{content}</link>\n'


def joint(
    name: str,
    kind: str,
    parent: str,
    child: str,
    *,
    xyz: str = "0 0 0",
    rpy: str = "0 0 0",
    axis: str = "0 0 1",
    limit: str = 'lower="-2.5" upper="2.5" effort="60" velocity="2"',
) -> str:
    limits = f"<limit {limit}/>" if kind != "fixed" else ""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>{limits}</joint>\n'
    )


WHEEL = '<cylinder radius="0.1" length="0.04"/>'
ARM_JOINTS = ("pan", "lift", "elbow", "turn", "wrist", "roll")


def cart(*, wheel: str = WHEEL, wheel_rpy: str = "1.5708 0 0") -> list[str]:
    """The base: a box on two wheels 0.4 m apart; its link is 0.15 m above the floor."""
    parts = [link("base", solid('<box size="0.6 0.4 0.2"/>', mass=30))]
    for name, y in (("left", 0.2), ("right", -0.2)):
        parts.append(link(f"{name}_wheel", solid(wheel, rpy=wheel_rpy)))
        parts.append(
            joint(
                f"{name}_axle",
                "continuous",
                "base",
                f"{name}_wheel",
                axis="0 1 0",
                xyz=f"0.05 {y} -0.05",
                limit='effort="20" velocity="12"',
            )
        )
    return parts


def arm() -> list[str]:
    """Six revolute joints on a column; the hand's frame is at most 0.82 m from the second joint."""
    tube = '<cylinder radius="0.04" length="0.34"/>'
    small = '<cylinder radius="0.035" length="0.08"/>'
    names = ("column", "shoulder", "upper", "fore", "cuff", "wrist_link", "hand")
    shapes = [
        solid('<cylinder radius="0.06" length="0.2"/>', xyz="0 0 0.1", mass=3),
        solid('<cylinder radius="0.055" length="0.08"/>', mass=2),
        solid(tube, xyz="0 0 0.17", mass=2),
        solid(tube, xyz="0 0 0.17", mass=1.5),
        solid(small, xyz="0 0 0.02"),
        solid(small, xyz="0 0 0.03"),
        solid(BOX, xyz="0 0 0.08", mass=0.7),
    ]
    offsets = ("0 0 0.24", "0 0 0.06", "0 0 0.34", "0 0 0.34", "0 0 0.07", "0 0 0.07")
    axes = ("0 0 1", "0 1 0", "0 1 0", "0 0 1", "0 1 0", "0 0 1")
    parts = [link(name, shape) for name, shape in zip(names, shapes, strict=True)]
    parts.append(joint("mount", "fixed", "base", "column", xyz="0.15 0 0.1"))
    for k, name in enumerate(ARM_JOINTS):
        parts.append(joint(name, "revolute", names[k], names[k + 1], xyz=offsets[k], axis=axes[k]))
    return parts


def robot(parts: Sequence[str]) -> str:
    return '<?xml version="1.0"?>\n<robot name="toy">\n' + "".join(parts) + "</robot>\n"


def write(folder: Path, text: str, name: str = "toy.urdf") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


BOX = '<box size="0.08 0.12 0.08"/>'
"""Shape of the end-effector."""


def with_mesh(text: str, reference: str) -> str:
    """The URDF `text` with the mesh file `reference` in place of the box `BOX`."""
    return text.replace(BOX, f'<mesh filename="{reference}"/>')


def cube() -> bytes:
    """A mesh of the end-effector's box, as STL."""
    mesh = trimesh.creation.box(extents=(0.08, 0.12, 0.08))
    stl = mesh.export(file_type="stl")
    assert isinstance(stl, bytes)
    return stl


def zipped(folder: Path, files: Mapping[str, str | bytes]) -> Path:
    """A file `toy.zip` in a folder, with these files."""
    path = folder / "toy.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return path


FAST_LINES = {name: line.changed(duration=3.0) for name, line in LINES.items()}
"""The scenarios' lines in short runs: runs take most of the onboarding time."""


def line_without_a_run(
    _: object, job: tuple[str, RobotModel, BorderData, bool], on_progress: OnProgress
) -> Place | str:
    """`line_from` with few postures, and without runs in which the base must move away."""
    name, model, data, _anyway = job
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(postures, "_SAMPLES", 800)
        return postures.find_place(model, data.pairs, name, on_progress=on_progress)


def few_postures(patch: pytest.MonkeyPatch) -> None:
    """Let bodies be fitted and judged with a third of the product's postures or less."""
    patch.setattr(meetings, "_TRIES", 4)
    patch.setattr(grouping, "TEST_POSTURES", 1300)
    for module in (new_robot, grouping, bodies):
        patch.setattr(module, "ENOUGH", 200)


@contextmanager
def few_samples(cache: Path) -> Iterator[SamplingConfig]:
    """Makes onboarding fast: few samples, short runs, the border stored in `cache`.

    Yields the configuration of the sampling.
    """
    with pytest.MonkeyPatch.context() as patch:
        few_postures(patch)
        patch.setattr(assets, "cache_folder", lambda: cache)
        patch.setattr(new_robot, "MEETING_SAMPLES", 1200)
        patch.setattr(postures, "_SAMPLES", 800)
        patch.setattr(postures, "LINES", FAST_LINES)
        patch.setattr(numbers, "COUNTED_POSTURES", 3000)
        yield SamplingConfig(
            pair_samples=2000,
            cloud_samples=2000,
            voxel_plan=0.05,
            voxel_height=0.05,
            rounds=1,
            retries=1,
            sectors=2,
        )
