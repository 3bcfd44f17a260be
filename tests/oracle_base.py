"""The three kinds of base of docs/bases.md, for the oracle."""

from __future__ import annotations

import numpy as np

from app.robot.bases.kind import BaseKind

Array = np.ndarray
STEADY = 1.5  # [-] energy ratio above which a moving car-like base reverses its direction


class OracleBase:
    """Parameters, linear maps and the command limits of one base."""

    def __init__(self, base: BaseKind) -> None:
        self.kind, self.mass, I = base.kind, base.mass_kg, base.inertia_kgm2
        self.a_max, self.v_max = np.array(base.max_acceleration), np.array(base.max_velocity)
        self._I, self.inertia = I, self.by_axis(self.mass, I)
        self.T = np.eye(3) if self.kind == "holonomic" else np.eye(3)[:, [0, 2]]
        self.kappa = self._square = 0.0
        if self.kind == "differential":
            r, b = base.wheel_radius_m, base.half_track_m  # type: ignore[attr-defined]
            self.J_m = r / 2 * np.array([[1, 1], [1 / b, -1 / b]])  # (19)
            self._square = 4 * b**2 * (r / (2 * b)) ** 4  # (7)
        elif self.kind == "car-like":
            L = base.wheelbase_m  # type: ignore[attr-defined]
            self.J_m = np.diag([1, 1 / L])
            self.kappa = np.tan(base.steering_limit_rad) / L  # type: ignore[attr-defined]
            self._square = 4 * self.kappa**2
        else:
            self.J_m = np.eye(3)
        self.to_q = np.linalg.inv(self.J_m)
        paper = 4 * 0.51**2 * (0.165 / 1.02) ** 4
        self.score_unit = self._square / paper if self.kind == "car-like" else 1.0

    def by_axis(self, linear: float, angular: float) -> Array:
        """`linear` for each translation, then `angular` for the rotation."""
        return np.array([linear] * (2 if self.kind == "holonomic" else 1) + [angular])

    def measure(self, x: float) -> tuple[float, float]:
        """The factor of R in (10), with its sign, and its derivative by x [m]."""
        if self.kind == "holonomic":
            return 1.0, 0.0
        return self._square * x * abs(x), 2 * self._square * abs(x)

    def acceleration(self, f_x: float, f_y: float, torque: float) -> Array:
        """(n_b,) the base's acceleration by (17) and (18), from forces [N] and torque [N m]."""
        return self.T.T @ np.array([f_x / self.mass, f_y / self.mass, torque / self._I])

    def admissible(self, command: Array, before: Array) -> Array:
        """The command; for a car, its projection into the cone, with preference for `before`."""
        if self.kind != "car-like" or abs(command[1]) <= self.kappa * abs(command[0]):
            return command
        turn = self.kappa * np.sign(command[1])
        found = {}
        for way in (1.0, -1.0):  # ahead, and backwards with the opposite curvature
            arc = np.array([1.0, way * turn])
            v = self.inertia * arc @ command / (self.inertia @ arc**2)
            found[way] = arc * (v if way * v > 0 else 0.0)
        favour = STEADY ** np.sign(before[0])
        energy = {way: self.inertia @ each**2 for way, each in found.items()}
        return found[1.0] if favour * energy[1.0] > energy[-1.0] else found[-1.0]
