"""A base that moves in every direction, on mecanum, omni or steered wheels."""

import math
from typing import ClassVar, Literal

import numpy as np

from app.robot.bases.kind import TURN, Axis, Measure, TurningBase
from app.strict import Array


class HolonomicBase(TurningBase):
    """A base with independent velocities ν = q̇_b = (v_x, v_y, ω); its measure is 1, so S = R."""

    axes: ClassVar[tuple[Axis, ...]] = (Axis("v_x", False), Axis("v_y", False, way="left"), TURN)

    kind: Literal["holonomic"]

    @property
    def J_m(self) -> Array:
        return np.eye(3)

    @property
    def yaw_limit_nm(self) -> float:
        """[N m] the torque of the traction force at the radius of gyration."""
        return self.traction_limit_n * math.sqrt(self.inertia_kgm2 / self.mass_kg)

    @property
    def measure(self) -> Measure:
        """1 [-] everywhere: no point is singular."""
        return Measure(1.0, 0.0)
