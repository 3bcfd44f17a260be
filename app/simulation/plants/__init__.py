"""Plants: pybullet, MuJoCo and a kinematic stand-in behind one interface."""

from __future__ import annotations

from importlib.util import find_spec
from typing import TYPE_CHECKING

from app.errors import ConfigError, check_name

if TYPE_CHECKING:
    from app.robot.model import RobotModel
    from app.simulation.plants.door import OpenDoor
    from app.simulation.plants.interface import Physics

PLANTS = ("planar", "kinematic", "mujoco", "mujoco-contact")  # names for `make_physics`

_FORMERLY = {"contact": "mujoco-contact"}
_DOORS = "planar, mujoco or mujoco-contact"


def default_plant() -> str:
    """The plant planar of pybullet, if that is installed; otherwise mujoco."""
    return "planar" if find_spec("pybullet") else "mujoco"


def chosen_plant(name: str | None) -> str:
    """The plant of `PLANTS` by its present or former name; the default without a name.

    Raises:
        UnknownNameError: The plant does not exist.
    """
    name = _FORMERLY.get(name, name) if name else default_plant()
    check_name("physics", name, PLANTS)
    return name


def make_physics(
    kind: str | None,
    model: RobotModel,
    *,
    dt: float = 0.001,
    door: OpenDoor | None = None,
) -> Physics:
    """The plant of that name, at rest in the robot's ready position.

    Args:
        kind: A name for `chosen_plant`.
        model: The robot.
        dt: [s] one step.
        door: A door that the end-effector holds from each reset on, or None.

    Raises:
        UnknownNameError: The plant does not exist.
        ConfigError: That plant has no doors, does not suit the kind of base, or needs a library
            that is not installed.
        AssetError: pybullet cannot load the robot.
    """
    kind = chosen_plant(kind)
    # Imported here, because each must work without the others' libraries.
    if kind == "planar" and not find_spec("pybullet"):
        raise ConfigError(
            "the plant planar needs pybullet, which is not installed and has no wheels for every "
            "Python (docs/install.md); --physics mujoco works without it"
        )
    if kind in ("planar", "mujoco"):
        from app.simulation.plants.planar import planar_plant

        return planar_plant("mujoco" if kind == "mujoco" else "pybullet", model, dt=dt, door=door)
    if kind == "mujoco-contact":
        from app.robot.bases.differential import DifferentialBase

        base = model.description.base
        if not isinstance(base, DifferentialBase):
            raise ConfigError(
                "the plant mujoco-contact turns the wheels of differential bases only; "
                f"{model.description.name} is {base.kind}: choose mujoco, planar or kinematic"
            )
        from app.simulation.plants.mujoco_wheels import MujocoWheels

        return MujocoWheels(model, dt=dt, door=door)
    if kind == "kinematic":
        from app.simulation.plants.kinematic import Kinematic

        if door is not None:
            raise ConfigError(f"the plant kinematic has no door; choose {_DOORS}")
        return Kinematic(model, dt=dt)
    raise NotImplementedError(f"make_physics has no branch for the plant {kind}")
