"""Checks of what avoidance needs: pairs, a border, and guiding runs in which nothing touches."""

from __future__ import annotations

import numpy as np

from app.border.cache import BorderData
from app.border.dbb import construct_dbb
from app.border.mobile import MobileBody
from app.config import Config
from app.errors import UnreachableError
from app.onboarding.check.row import Row
from app.onboarding.fit.collision_sampling import ALWAYS
from app.robot.link_pairs import PairDistances, sample_joints
from app.robot.model import RobotModel

_LAYER = 0.05  # [m]
_NEAR_POSES = 1000
_MANY = 500  # [-] points nearer than the border by which a layer counts as reached
_FEW = 10  # [-] points of the border in a layer that is not empty


def pairs_row(model: RobotModel, data: BorderData) -> Row:
    """There are pairs, each body of L_m has a reachability, and none is near for good."""
    pairs, d_b = data.pairs, Config().border.d_b
    if not pairs.mobile:
        return Row("pairs", "warned", "no part of the arm can meet the base", {})
    missing = [p.b for p in pairs.mobile if p.b not in model.description.reachability]
    reader = PairDistances(model, pairs.all)
    q = model.configuration((0.0, 0.0, 0.0), model.q_lower)
    distances = []
    for q_m in sample_joints(model, _NEAR_POSES, np.random.default_rng(1)):
        q[4:] = q_m
        reader.update(q)
        distances.append([reader.distance(i) for i in range(len(pairs.all))])
    seen = np.array(distances)
    free = (seen > 0.0).all(axis=1)
    near = (seen[free] < d_b).mean(axis=0) if free.any() else np.ones(len(pairs.all))
    names = [pair.name for pair in pairs.all]
    numbers = {f"near_{name}": float(share) for name, share in zip(names, near, strict=True)}
    if missing:
        text = f"no reachability of {', '.join(missing)}, which can meet the base"
        return Row("pairs", "failed", text, numbers)
    always = [name for name, share in zip(names, near, strict=True) if share > ALWAYS]
    if always:
        text = f"{', '.join(always)}: inside the buffer in more than {ALWAYS:.0%} of free poses"
        return Row("pairs", "warned", text, numbers)
    text = f"{', '.join(names)}; inside the buffer in {near.max():.0%} of free poses at most"
    return Row("pairs", "passed", text, numbers)


def border_row(model: RobotModel, data: BorderData) -> Row:
    """Each pair of L_m has a border, without a gap between the heights that it has.

    At the lowest and highest heights that the arm reaches it may not get as far out as the border:
    there the exact offset of l_m stands in, which is told.
    """
    if not data.clouds:
        return Row("border", "warned", "no part of the arm can meet the base: there is none", {})
    border, top = Config().border, float(MobileBody(model).upper[2])
    empty, ends, numbers = [], [], {}
    for name, cloud in data.clouds.items():
        made = construct_dbb(cloud, border.d_b, border.eps)
        numbers[f"points_{name}"] = float(len(made))
        if not len(made):
            empty.append(f"{name} has no point at all")
            continue
        inside = cloud.points_m[cloud.d_m < border.d_b - border.eps][:, 2]
        lowest, highest = float(made.heights[0]), float(made.heights[-1])
        for z in np.arange(_LAYER / 2, top, _LAYER).round(3).tolist():
            reached = np.count_nonzero(np.abs(inside - z) < _LAYER / 2) >= _MANY
            if reached and len(made.same_height(z, _LAYER / 2)) < _FEW:
                between = lowest < z - _LAYER and z + _LAYER < highest
                (empty if between else ends).append(f"{name} at z = {z:.2f} m")
    if empty:
        outcome = "failed" if any("at all" in each for each in empty) else "warned"
        return Row("border", outcome, f"no points of {'; '.join(empty)}", numbers)
    text = "at every height that the arm reaches beside the base: "
    text += ", ".join(f"{n.removeprefix('points_')} {c:,.0f} points" for n, c in numbers.items())
    if ends:
        text += f"; at the end of its reach the exact offset stands in: {', '.join(ends)}"
    return Row("border", "passed", text, numbers)


CLEARANCE = 0.03
"""[m] least distance of a pair with the base that passes."""


def run_row(model: RobotModel, data: BorderData, name: str) -> Row:
    """A guiding run with the default parameters.

    Where the arm cannot start there is nothing to judge, which is warned of.
    """
    from app.simulation.run import run_scenario
    from app.simulation.scenarios.names import scenario_of

    scenario = scenario_of(model.description, name)
    try:
        figures = run_scenario(model, data, scenario, Config()).figures
    except UnreachableError as error:
        return Row(name, "warned", f"not done: {error}", {})
    clearance = figures["min_clearance_m"]
    touched = sum(int(str(figures[k])) for k in ("contacts", "arm_contacts", "floor_contacts"))
    failures = int(str(figures["solver_failures"]))
    numbers = {"contacts": float(touched), "solver_failures": float(failures)}
    text = f"{touched} steps in contact, {failures} without a solution"
    near = float(str(clearance)) if clearance is not None else None
    if near is not None:
        numbers["min_clearance_m"] = near
        text = f"least distance to the base {near:.3f} m, {text}"
    good = not touched and not failures and (near is None or near >= CLEARANCE)
    return Row(name, "passed" if good else "failed", text, numbers)
