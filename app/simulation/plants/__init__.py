"""Plants, which simulate the robot: with pybullet, with MuJoCo, or without a physics engine."""

from __future__ import annotations

from importlib.util import find_spec
from typing import TYPE_CHECKING

from app.errors import ConfigError, check_name

if TYPE_CHECKING:
    from app.robot.model import RobotModel
    from app.simulation.plants.door import OpenDoor
    from app.simulation.plants.interface import Physics

PLANTS = ("planar", "kinematic", "mujoco", "mujoco-contact")  # names of plants
_FORMERLY = {"contact": "mujoco-contact"}


def default_plant() -> str:
    """The default plant: `planar` if pybullet is installed, otherwise `mujoco`."""
    return "planar" if find_spec("pybullet") else "mujoco"


def chosen_plant(name: str | None) -> str:
    """The present name of a plant, by default `default_plant`; may raise an UnknownNameError."""
    name = _FORMERLY.get(name, name) if name else default_plant()
    check_name("physics", name, PLANTS)
    return name


def make_physics(
    kind: str | None, model: RobotModel, *, dt: float = 0.001, door: OpenDoor | None = None
) -> Physics:
    """Make the plant `kind`, by default `default_plant`, with steps of `dt` [s]. The robot is at
    rest in its ready posture. The end-effector holds any `door`, also after each reset.

    Raises:
        UnknownNameError: The plant does not exist.
        ConfigError: The plant does not suit the door or the base, or pybullet is not installed.
        AssetError: With `planar`, a mesh is missing, or pybullet cannot load the robot.
        RobotFileError: A mesh is damaged or, with MuJoCo, exceeds the limits of `collision_shapes`.
    """
    kind = chosen_plant(kind)
    if kind == "planar" and not find_spec("pybullet"):
        from app.simulation.plants.interface import PYBULLET_MISSING

        why = f"the plant planar {PYBULLET_MISSING}"
        raise ConfigError(f"{why}; --physics mujoco works without pybullet")
    # Imported here, because each plant must work without the libraries of the other plants.
    if kind in ("planar", "mujoco"):
        from app.simulation.plants.planar import Planar

        return Planar("pybullet" if kind == "planar" else "mujoco", model, dt=dt, door=door)
    if kind == "mujoco-contact":
        from app.robot.bases.differential import DifferentialBase

        base = model.description.base
        if not isinstance(base, DifferentialBase):
            own = f"the base of {model.description.name} is {base.kind}"
            why = f"the plant mujoco-contact suits only differential bases; {own}"
            raise ConfigError(f"{why}: choose mujoco, planar or kinematic")
        from app.simulation.plants.mujoco_wheels import MujocoWheels

        return MujocoWheels(model, dt=dt, door=door)
    assert kind == "kinematic", f"make_physics has no branch for {kind}"
    from app.simulation.plants.kinematic import Kinematic

    if door is not None:
        raise ConfigError("kinematic has no door; choose planar, mujoco or mujoco-contact")
    return Kinematic(model, dt=dt)
