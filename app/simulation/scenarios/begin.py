"""A session that stands where a scenario begins."""

from __future__ import annotations

from app.robot.model import RobotModel
from app.simulation.scenarios.leading import Setting
from app.simulation.session import Session


def begin(
    setting: Setting, robot: RobotModel, *, controller: str, physics: str | None, seed: int
) -> Session:
    """A new session at the beginning of a setting.

    Args:
        setting: Where it begins.
        robot: The robot as it is, without the door that the setting's may hold.
        controller: One of `app.control.controller.CONTROLLERS`.
        physics: Kind of plant; the default one if None.
        seed: Of everything random.

    Raises:
        ConfigError: The plant has no doors, and the setting has one.
        UnknownNameError: No such controller or plant.
    """
    session = Session(
        setting.model,
        setting.data,
        setting.config,
        controller=controller,
        physics=physics,
        seed=seed,
        plant=robot,
        door=setting.door,
    )
    session.reset(setting.q_m, setting.base_pose)
    return session
