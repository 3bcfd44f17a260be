"""The plants by their names."""

from __future__ import annotations

import importlib.util

from app.errors import ConfigError, UnknownNameError
from app.robot.bases.differential import DifferentialBase
from app.robot.model import RobotModel
from app.simulation.door import OpenDoor
from app.simulation.physics import Physics

PLANTS = ("planar", "contact", "kinematic")
"""Names that `make_physics` knows."""
_OF_PYBULLET = ("planar", "contact")
DEFAULT_PLANT = "planar" if importlib.util.find_spec("pybullet") else "mujoco"
"""pybullet's where it is installed: on CPython 3.14 and on Linux aarch64 it has no wheels."""


def make_physics(
    kind: str, model: RobotModel, *, dt: float = 0.001, seed: int = 0, door: OpenDoor | None = None
) -> Physics:
    """The plant of that name, at rest in the robot's ready position.

    Args:
        kind: One of `PLANTS`.
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
    if kind in _OF_PYBULLET and DEFAULT_PLANT not in _OF_PYBULLET:
        raise ConfigError(
            f"the plant {kind} needs pybullet, which is not installed and has no wheels for every "
            "Python (docs/install.md); --physics mujoco works without it"
        )
    # Imported here: the others have to work where pybullet is not installed.
    if kind == "planar":
        from app.simulation.pybullet_planar import PybulletPlanar

        return PybulletPlanar(model, dt=dt, door=door)
    if kind == "contact":
        base = model.description.base
        if not isinstance(base, DifferentialBase):
            raise ConfigError(
                "the plant contact drives two wheels, and takes differential bases only; "
                f"{model.description.name} is {base.kind}: choose planar or kinematic"
            )
        from app.simulation.pybullet_contact import PybulletContact

        return PybulletContact(model, dt=dt, door=door)
    if kind == "kinematic":
        if door is not None:
            raise ConfigError("the plant kinematic has no door; choose planar or contact")
        from app.simulation.kinematic import Kinematic

        return Kinematic(model, dt=dt)
    raise UnknownNameError("physics", kind, PLANTS)
