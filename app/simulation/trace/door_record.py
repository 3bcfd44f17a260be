"""Figures and columns of a run in which a door is opened."""

from __future__ import annotations

import math

import numpy as np

from app.simulation.plants.door import BODY
from app.simulation.session import Step

_OPENED = math.radians(80)  # [rad] when the door counts as opened
_ESTIMATE_AT = 5.0  # [s] when the estimate of the radial direction is judged
_BACKED_OFF = 0.01  # [m] of the base's motion from which on it counts as one


class DoorRecord:
    """Takes every control step of an opening; gives its figures."""

    def __init__(self) -> None:
        self._first: Step | None = None
        self._angle = 0.0
        self._least = math.inf
        self._contacts = 0
        self._opened: float | None = None
        self._touched: float | None = None
        self._met: float | None = None
        self._backed_off: float | None = None
        self._radial_error: float | None = None

    def add(self, step: Step) -> None:
        """Take one control step."""
        assert step.door is not None
        if self._first is None:
            self._first = step
        self._angle = step.door.angle
        distance = door_distance(step)
        self._least = min(self._least, distance)
        touches = step.contacts.door_base
        self._contacts += touches
        if touches and self._touched is None:
            self._touched = step.t
        if (touches or distance <= 0.0) and self._met is None:
            self._met = step.t
        if self._opened is None and self._angle >= _OPENED:
            self._opened = step.t
        moved = step.truth.base_pose - self._first.truth.base_pose
        if self._backed_off is None and np.hypot(*moved[:2]) >= _BACKED_OFF:
            self._backed_off = step.t
        if self._radial_error is None and step.t >= _ESTIMATE_AT:
            self._radial_error = step.door.radial_error

    def figures(self) -> dict[str, object]:
        """The figures of the opening so far; a time that never came is None."""
        return {
            "door_angle_final_rad": self._angle,
            "door_opened_80deg_at_s": self._opened,
            "door_min_distance_m": self._least,
            "door_contacts": self._contacts,
            "first_door_contact_s": self._touched,
            "door_met_base_s": self._met,
            "radial_error_at_5s_rad": self._radial_error,
            "base_back_off_s": self._backed_off,
        }


def door_distance(step: Step) -> float:
    """[m] true signed distance between the mobile robot and the door."""
    pairs = zip(step.output.avoidance.pairs, step.distances, strict=True)
    return next(d for pair, d in pairs if pair.closest.pair.b == BODY)


def door_columns(step: Step) -> dict[str, float]:
    """What the log has besides, where a door is opened."""
    assert step.door is not None
    return {
        "door_angle_rad": step.door.angle,
        "radial_error_rad": step.door.radial_error,
        "radial_force_n": step.door.radial_force,
        "door_contact": int(step.contacts.door_base),
    }
