"""A, B, C of (9) for every body that can come near the base."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from app.border.reach.chain import reach_bodies
from app.border.reach.config import ReachConfig
from app.border.reach.fit import ReachFit, fit_reachability
from app.border.reach.map import PEAK, ReachMap, load_reach_map
from app.errors import DescriptionError
from app.robot.link_pairs import LinkPairs, sample_joints
from app.robot.model import RobotModel
from app.robot.state import RobotState, at_rest

Array = np.ndarray

SHARE = 0.5
"""[-] of the peak above which (9) is fitted: its upper part is a parabola, its tails are none."""
COUNTING = ReachConfig(
    spacing_m=0.08, orientations=12, restart_spacing_m=0.12, restart_orientations=1, restarts=6
)
"""Coarser than `dbb reach`, a tenth of its time: the coefficients change by some per cent."""
_SAMPLES = 2000
_WIDTH = 3.0  # [-] standard deviations of ρ at which an assumed reachability has fallen to zero
_LEAST_WIDTH = 0.1  # [m]


class Reach(NamedTuple):
    """Of one body.

    Attributes:
        A, B, C: [1/m²], [m], [-] of (9).
        source: In words.
        counted: The map, or None where the coefficients are assumed.
        fit: How well (9) fits it, or None.
    """

    A: float
    B: float
    C: float
    source: str
    counted: ReachMap | None
    fit: ReachFit | None

    def content(self) -> dict[str, Any]:
        """As a description has it."""
        names = ("A_per_m2", "B_m", "C")
        values = (round(self.A, 1), round(self.B, 4), round(self.C, 1))
        return dict(zip(names, values, strict=True)) | {"source": dict.fromkeys(names, self.source)}


def find_reach(
    model: RobotModel, pairs: LinkPairs, *, processes: int | None = None
) -> dict[str, Reach]:
    """The coefficients of all bodies of L_m, by name.

    A body that fewer than three joints move, or whose map (9) does not fit, gets a parabola about
    the distances that it has in random poses: assumed, and said so.

    Args:
        model: The robot.
        pairs: Its pairs.
        processes: To count with.
    """
    can = reach_bodies(model)
    found = {}
    for pair in pairs.mobile:
        if pair.b not in can:
            found[pair.b] = _assumed(model, pair.b, "fewer than three joints move it")
            continue
        try:
            counted = load_reach_map(model, pair.b, config=COUNTING, processes=processes)
            fit = fit_reachability(counted, SHARE)
        except DescriptionError as error:
            found[pair.b] = _assumed(model, pair.b, str(error))
            continue
        text = (
            f"counted: as `dbb reach` does, {counted.poses:,} poses, {counted.method}; fitted "
            f"above {SHARE:g} of the peak, R² {fit.r_squared:.2f}"
        )
        found[pair.b] = Reach(fit.A_per_m2, fit.B_m, fit.C, text, counted, fit)
    return found


def _assumed(model: RobotModel, body: str, why: str) -> Reach:
    """A parabola about the middle of the distances that the body's shape has from the mount."""
    state, mount = RobotState(model), model.p_base()
    shape = model.geometry.geometryObjects[model.shape_ids[body][0]]
    rho = []
    for q in sample_joints(model, _SAMPLES, np.random.default_rng(0)):
        state.update_kinematics(at_rest(model, q))
        at = state.data.oMi[shape.parentJoint] * shape.placement
        rho.append(float(np.linalg.norm(at.translation - mount)))
    B, width = float(np.mean(rho)), max(_WIDTH * float(np.std(rho)), _LEAST_WIDTH)
    source = f"assumed: a parabola about the body's distances in random poses; {why}"
    return Reach(PEAK / width**2, B, PEAK, source, None, None)
