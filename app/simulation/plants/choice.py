"""The plants by their names."""

from __future__ import annotations

from importlib.util import find_spec

from app.errors import ConfigError, UnknownNameError
from app.robot.bases.differential import DifferentialBase
from app.robot.model import RobotModel
from app.simulation.plants.door import OpenDoor
from app.simulation.plants.interface import Physics

PLANTS = ("planar", "kinematic", "mujoco", "mujoco-contact")
"""Names that `make_physics` knows."""

_FORMERLY = {"contact": "mujoco-contact"}
_DOORS = "planar, mujoco or mujoco-contact"


def default_plant() -> str:
    """planar, which is pybullet's, where that is installed; else mujoco."""
    return "planar" if find_spec("pybullet") else "mujoco"


def chosen_plant(name: str | None) -> str:
    """One of `PLANTS` by its name, or by one that it had formerly; the default without a name.

    Raises:
        UnknownNameError: No such plant.
    """
    name = _FORMERLY.get(name, name) if name else default_plant()
    if name not in PLANTS:
        raise UnknownNameError("physics", name, PLANTS)
    return name


def make_physics(
    kind: str | None,
    model: RobotModel,
    *,
    dt: float = 0.001,
    seed: int = 0,
    door: OpenDoor | None = None,
) -> Physics:
    """The plant of that name, at rest in the robot's ready position.

    Args:
        kind: As `chosen_plant` takes it.
        model: The robot.
        dt: [s] one step.
        seed: Of what a plant draws at random; none of these draws anything.
        door: A door that the hand holds from each reset on, or None.

    Raises:
        UnknownNameError: No such plant.
        ConfigError: That plant has no doors, does not suit the kind of base, or needs a library
            that is not installed.
        AssetError: pybullet cannot load the robot.
    """
    del seed
    kind = chosen_plant(kind)
    # Imported here: each has to work where the others' libraries are not installed.
    if kind == "planar":
        if not find_spec("pybullet"):
            raise ConfigError(
                "the plant planar needs pybullet, which is not installed and has no wheels for "
                "every Python (docs/install.md); --physics mujoco works without it"
            )
        from app.simulation.plants.pybullet_planar import PybulletPlanar

        return PybulletPlanar(model, dt=dt, door=door)
    if kind == "mujoco":
        from app.simulation.plants.mujoco_planar import MujocoPlanar

        return MujocoPlanar(model, dt=dt, door=door)
    if kind == "mujoco-contact":
        base = model.description.base
        if not isinstance(base, DifferentialBase):
            raise ConfigError(
                "the plant mujoco-contact turns the wheels of differential bases only; "
                f"{model.description.name} is {base.kind}: choose mujoco, planar or kinematic"
            )
        from app.simulation.plants.mujoco_wheels import MujocoWheels

        return MujocoWheels(model, dt=dt, door=door)
    if door is not None:
        raise ConfigError(f"the plant kinematic has no door; choose {_DOORS}")
    from app.simulation.plants.kinematic import Kinematic

    return Kinematic(model, dt=dt)
