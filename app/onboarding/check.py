"""`dbb check-robot`: checks of a description, its URDF and its meshes."""

import logging
from collections.abc import Callable, Iterator
from contextlib import closing
from functools import partial
from importlib.util import find_spec
from itertools import compress
from typing import Literal, NamedTuple

import numpy as np
import pinocchio as pin

from app.border.cache import BorderData, load_border_data
from app.border.dbb import construct_dbb
from app.border.mobile import MobileBody
from app.border.sampling import SamplingConfig
from app.errors import DbbError, UnreachableError
from app.onboarding import SIDES, warn
from app.onboarding.fit.grouping import MAX_UNDETECTED, detection_of
from app.onboarding.fit.meetings import ALWAYS, ENOUGH, GRAZE, NESTED
from app.onboarding.fit.postures import CLEARANCE, GIVES_WAY, judge_ready
from app.onboarding.fit.travel import filled
from app.onboarding.fit.units import link_distances, link_shapes, units_of_links
from app.onboarding.numbers import gravity_load, largest_of_postures
from app.onboarding.read.links import LinkGeometry, read_geometry
from app.onboarding.read.source import read_robot
from app.onboarding.read.tree import Tree, make_tree
from app.robot.assets import resolved_urdf, urdf_path
from app.robot.description import RobotDescription
from app.robot.link_pairs import PairDistances, sample_joints
from app.robot.model import RobotModel
from app.robot.state import Measurement, RobotState
from app.simulation.trace.columns import axis_name

_log = logging.getLogger(__name__)
Outcome = Literal["passed", "warned", "failed", "nothing to show"]

_FASTEST = 20.0  # [rad/s or m/s] largest plausible speed of a joint
_LAYER = 0.05  # [m] height of a layer of the border
_TOUCHED = {
    "in_contact": "arm and base",
    "arm_in_contact": "the arm and itself",
    "floor_contact": "the arm and the floor",
}


class Row(NamedTuple):
    """The result of one check."""

    name: str
    outcome: Outcome  # "nothing to show" if no posture, or no run, tests the robot
    text: str
    numbers: dict[str, float]  # the measured values by their names


def check_robot(
    description: RobotDescription,
    *,
    runs: bool = True,
    tell: Callable[[str], None] = lambda _: None,
    processes: int | None = None,
    sampling: SamplingConfig | None = None,
) -> Iterator[Row]:
    """All checks of a description; each row is yielded when its check ends.

    A check that ends with an error fails, and its row has the message. If model or border cannot be
    made, the checks that need it are left out. With `runs` and pairs of arm and base, the last row
    is a failed row `guiding` if each run ends with an error, cannot start or has "nothing to show".

    `runs` selects whether the guiding runs, which take most of the time, are simulated. `tell` is
    called with the name of each step before it begins. `processes` is the number of processes for
    the border (default: one for each usable core); `sampling` has parameters of a coarser border.
    """
    tell("loading the robot")
    try:
        model = RobotModel(description)
    except DbbError as error:
        yield Row("pinocchio", "failed", str(error), {})
        return
    text = f"loads: {model.n_m} joints, {len(model.body_names)} bodies"
    yield Row("pinocchio", "passed", text, {})
    for name, check in {
        "pybullet": partial(dynamics_row, name="pybullet"),
        "mujoco": partial(dynamics_row, name="mujoco"),
        "engines": engines_row,
        "limits": limits_row,
        **({"nested links": nested_row} if description.nested else {}),
        "base's body": base_row,
        "arm's bodies": arm_row,
        "end-effector in place": holding_row,
    }.items():
        tell(name)
        yield _done(name, check, model)
    tell("sampling pairs and border")
    try:
        data = load_border_data(model, sampling=sampling, processes=processes)
    except DbbError as error:
        yield Row("border", "failed", str(error), {})
        return
    checks = {"pairs": pairs_row, "push": push_row, "ready pose": ready_row, "border": border_row}
    guided = SIDES if runs else ()
    rows: list[Row] = []
    for name, check in (checks | {name: partial(run_row, name=name) for name in guided}).items():
        tell(name)
        rows.append(_done(name, check, model, data))
        yield rows[-1]
    shown = any(r.numbers and r.outcome != "nothing to show" for r in rows[len(checks) :])
    if runs and data.pairs.mobile and not shown:
        yield Row("guiding", "failed", "no guiding run tests the base", {})


def _done(name: str, check: Callable[..., Row], *arguments: object) -> Row:
    """The row of a check; an exception becomes a failed row."""
    try:
        return check(*arguments)
    except Exception as error:  # pybullet, MuJoCo, coal: without a common base class
        _log.debug("%s", name, exc_info=True)
        kind = "" if isinstance(error, DbbError) else f"{type(error).__name__}: "
        return Row(name, "failed", f"{kind}{error}", {})


def dynamics_row(model: RobotModel, name: Literal["pybullet", "mujoco"]) -> Row:
    """Compare M and C q̇ + g of pinocchio and of an engine; warn if the engine is not installed."""
    if not find_spec(name):
        return Row(name, "warned", f"{name} is not installed; try: pip install {name}", {})
    from app.simulation.plants.planar import Planar

    engine = Planar(name, model)
    rng, state, n_b = np.random.default_rng(0), RobotState(model), model.n_b
    worst = {"M_difference": 0.0, "nle_difference": 0.0}
    with closing(engine):
        for q_m in sample_joints(model, 20, rng):
            qd = np.concatenate([rng.uniform(-1, 1, n_b), rng.uniform(-0.5, 0.5, model.n_m)])
            state.update(Measurement(np.zeros(3), model.J_m @ qd[:n_b], q_m, qd[n_b:]))
            ours = (state.M, state.h)
            for key, theirs, own in zip(worst, engine.mass_and_bias(q_m, qd), ours, strict=True):
                worst[key] = max(worst[key], float(np.abs(theirs - own).max() / np.abs(own).max()))
    most = max(worst.values())
    text = f"M and C q̇ + g differ from pinocchio's by {most:.1e} of the largest entry"
    if most < 1e-6:
        return Row(name, "passed", text, worst)
    text += "; add an <inertial> to every link, with the mass 0 for frames"
    return Row(name, "failed", text, worst)


def engines_row(model: RobotModel) -> Row:
    """Compare depth images and contacts of pybullet and MuJoCo; warn if one is not installed."""
    if missing := [name for name in ("pybullet", "mujoco") if not find_spec(name)]:
        text = f"{missing[0]} is not installed, so there is no second engine for a comparison"
        return Row("engines", "warned", text, {})
    from app.simulation.plants.planar import SAME_DEPTH, SAME_PICTURE, compare_engines

    found = compare_engines(model)
    good = found.picture < SAME_PICTURE and found.depth < SAME_DEPTH
    deepest = f"the deepest contact of one engine alone is {1e3 * found.depth:.1f} mm"
    text = f"pictures differ in {found.picture:.1%} of their rays"
    text += f"; in {found.postures} postures {deepest}"
    numbers = {"picture_difference": found.picture, "contact_difference_m": found.depth}
    return Row("engines", "passed" if good else "failed", text, numbers)


def limits_row(model: RobotModel) -> Row:
    """Check limits, and that each joint moves inertia; warn if a torque limit is below gravity."""
    names, efforts, data = model.description.arm.joints, model.tau_max, model.pin.createData()
    load = gravity_load(model)
    least = -largest_of_postures(model, lambda q: -np.diag(pin.crba(model.pin, data, q))[3:])
    strongest = np.array([20_000.0 if unit == "m" else 2000.0 for unit in model.joint_units])
    wrong = [
        f"{names[k]} has {model.qd_max[k]:g} rad/s (or m/s) and {efforts[k]:g} N m (or N), but at "
        f"most {_FASTEST:g} and {strongest[k]:g} are plausible"
        for k in np.flatnonzero((model.qd_max > _FASTEST) | (efforts > strongest))
    ]
    wrong += [f"{names[k]} moves no inertia" for k in np.flatnonzero(least <= 1e-9)]
    weak = "; ".join(
        f"{names[k]} has {efforts[k]:g} of the required {load[k]:.3g} N m (or N)"
        for k in np.flatnonzero(efforts < load)
    )
    share = float((load / efforts).max())
    numbers = {"gravity_share": share}
    if wrong:
        return Row("limits", "failed", "; ".join(wrong), numbers)
    if weak:
        text = f"some joints cannot hold the arm's weight in all postures: {weak}"
        return Row("limits", "warned", text, numbers)
    text = f"gravity requires at most {share:.0%} of the torque limit of a joint"
    return Row("limits", "passed", text, numbers)


def nested_row(model: RobotModel) -> Row:
    """Warn of nested links that touch in no posture, or in under 25 % and overlap by over 3 mm."""
    by_body = units_of_links(model, _geometry(model)[1])
    shapes = link_shapes(model, [unit for units in by_body.values() for unit in units])
    named = sorted((min(pair), max(pair)) for pair in model.description.nested)
    shaped = [pair for pair in named if shapes.keys() >= {*pair}]
    q_m = sample_joints(model, ENOUGH, np.random.default_rng(0))
    gaps = link_distances(model, shapes, shaped, q_m)
    shares, overlaps = (gaps <= 0.0).mean(axis=0).tolist(), (-gaps).max(axis=0).tolist()
    touches = dict.fromkeys(named, (0.0, 0.0))  # stays 0 for a link without a shape
    touches.update(zip(shaped, zip(shares, overlaps, strict=True), strict=True))
    least = min(share for share, _ in touches.values())
    text = f"each pair of nested links touches in at least {least:.0%} of random postures"
    seldom = ", ".join(
        f"{a} and {b} in {share:.0%}"
        for (a, b), (share, overlap) in touches.items()
        if share < NESTED and (share == 0.0 or overlap > GRAZE)
    )
    if seldom:
        text = f"plants ignore the contacts of links that touch in few postures: {seldom}"
    numbers = {"least_touching_share": least}
    return Row("nested links", "warned" if seldom else "passed", text, numbers)


def base_row(model: RobotModel) -> Row:
    """Check that, above the floor, hulls of the base's links extend beyond l_m by at most 1 cm."""
    unit = units_of_links(model, _geometry(model)[1])[model.body_names[0]]
    points = np.vstack([np.zeros((0, 3)), *(part.corners for part in unit[0].parts)])
    points = points[points[:, 2] > 0.0]
    if not len(points):
        return Row("base's body", "failed", "the base's links have no shapes", {})
    out = float(MobileBody(model).distance(points).max())
    text = f"the base's meshes extend beyond its body by at most {max(out, 0.0):.4f} m"
    return Row("base's body", "passed" if out <= 0.01 else "failed", text, {"sticks_out_m": out})


def arm_row(model: RobotModel) -> Row:
    """Check that pairs of bodies detect the collisions of links in random postures. The section
    *Undetected collisions* of docs/other_robots.md has the condition of each outcome.
    """
    found = detection_of(model, *_geometry(model), model.description.config.border.d_b)
    numbers = {
        "colliding_poses": float(found.postures),
        "unseen_poses": float(found.undetected),
        "collisions": float(found.watched),
        "missed": float(found.missed),
        "missed_distance_m": found.deepest,
        "unseen_share": found.share,
        "left_out_poses": float(found.left_out),
    }
    text = f"links collide in {found.postures} of {found.looked_at:,} random postures"
    text += f"; in {found.undetected} of these, the collision is undetected"
    if found.undetected:
        text += f"; most undetected collisions are of {found.worst}"
    if found.missed:
        text += f"; bodies do not enclose their links in {found.missed} of {found.watched} "
        text += f"collisions, by at most {found.deepest:.3f} m"
    if found.left_out:
        text += f"; {found.left_out} other postures do not count, because only links meet that are "
        text += f"neighbours or close by design: {found.rule}"
    if found.blind:
        text += f"; the bodies of {', '.join(found.blind)} do not enclose their colliding links"
    outcome: Outcome = "passed" if found.postures else "nothing to show"
    if found.fails or found.missed > MAX_UNDETECTED * found.watched:
        outcome = "failed"
    elif found.missed or found.left_out > MAX_UNDETECTED * found.looked_at:
        outcome = "warned"
    return Row("arm's bodies", outcome, text, numbers)


def _geometry(model: RobotModel) -> tuple[Tree, dict[str, LinkGeometry]]:
    """The robot's tree; the geometry of its links, with the motions of some: see `filled`."""
    resolved_urdf(model.description)  # refuses damaged meshes
    tree = make_tree(read_robot(urdf_path(model.description))[0])
    chain = [tree.joints[name] for name in model.description.arm.joints]
    return tree, filled(tree, read_geometry(tree), chain)


def holding_row(model: RobotModel) -> Row:
    """Warn if the arm often (over 25 %) cannot hold its end-effector while the base moves."""
    carried = warn.carried_ee(model)
    numbers = {
        f"{what}_lost_{axis_name(each.axis)}_share": getattr(each, what)
        for each in carried
        for what in ("place", "pose")
    }
    worst = max(each.place for each in carried)
    text = f"the arm can hold its end-effector in place in {1 - worst:.0%} of the postures"
    warning = warn.holding_warning(carried)
    return Row("end-effector in place", "warned" if warning else "passed", warning or text, numbers)


def push_row(model: RobotModel, data: BorderData) -> Row:
    """Warn if a person can push the arm against the base in over 25 % of the postures near it."""
    borne = warn.borne_push(model, data.pairs.mobile)
    if not len(borne):
        return Row("push", "passed", "no monitored part of the arm can meet the base", {})
    person = model.description.config.hand.f_max
    numbers = {"least_push_borne_n": float(borne.min())}
    weak = float((borne < person).mean())
    text = f"in all postures near the base, the joint torques resist a push of {borne.min():.0f} N"
    if weak > warn.OFTEN:
        worst = f"they resist {np.quantile(borne, warn.OFTEN):.0f} N or less"
        share = f"{weak:.0%} of the postures near the base"
        resist = f"in {share} the joint torques resist only a smaller force"
        text = f"a person with {person:g} N can push the arm against the base: {resist}"
        text += f"; in the worst {warn.OFTEN:.0%} {worst}"
    elif weak > 0.0:
        text += f"; in {weak:.0%} of the postures, a push of {person:g} N is too strong for them"
    return Row("push", "warned" if weak > warn.OFTEN else "passed", text, numbers)


def pairs_row(model: RobotModel, data: BorderData) -> Row:
    """Check that each body in a pair with l_m has a reachability; warn if no pair has l_m, or if a
    pair is inside its buffer in most postures without contact.
    """
    pairs, d_b = data.pairs, model.description.config.border.d_b
    if not pairs.mobile:
        return Row("pairs", "warned", "no monitored part of the arm can meet the base", {})
    missing = [p.b for p in pairs.mobile if p.b not in model.description.reachability]
    postures = sample_joints(model, 1000, np.random.default_rng(1))
    d = PairDistances(model, pairs.all).sampled(postures)
    free = (d > 0.0).all(axis=1)
    near = (d[free] < d_b).mean(axis=0) if free.any() else np.ones(len(pairs.all))
    names = [pair.name for pair in pairs.all]
    numbers = {f"near_{name}": float(share) for name, share in zip(names, near, strict=True)}
    if missing:
        text = f"{', '.join(missing)} can meet the base, but has no reachability"
        return Row("pairs", "failed", text, numbers)
    if always := ", ".join(compress(names, near > ALWAYS)):
        text = f"{always}: inside the buffer in more than {ALWAYS:.0%} of the free postures"
        return Row("pairs", "warned", text, numbers)
    text = f"{', '.join(names)}; inside the buffer in at most {near.max():.0%} of the free postures"
    return Row("pairs", "passed", text, numbers)


def ready_row(model: RobotModel, data: BorderData) -> Row:
    """Warn if the ready posture is near a position limit, or inside the buffer of a pair."""
    q_m = np.array(model.description.arm.ready_position)
    span = model.q_upper - model.q_lower
    left = float((np.minimum(q_m - model.q_lower, model.q_upper - q_m) / span).min())
    numbers, text, good = {"least_joint_margin": left}, "no bodies can meet", left >= 0.02
    if data.pairs.all:
        ready = judge_ready(model, data.pairs, q_m)
        numbers["beyond_buffer_m"], good = ready.beyond_buffer, good and ready.beyond_buffer >= 0
        text = f"{ready.nearest} is {ready.beyond_buffer:+.3f} m from its buffer"
    text += f"; the smallest distance of a joint from its limits is {left:.0%} of its range"
    return Row("ready pose", "passed" if good else "warned", text, numbers)


def border_row(model: RobotModel, data: BorderData) -> Row:
    """Check that each border has points at all heights, up to the top of l_m, that the arm reaches.

    The check fails if all borders are empty. It warns if no pair has l_m, or if a border has a gap
    between its lowest and its highest point. Beyond these, the exact offset of l_m replaces it.
    """
    if not data.clouds:
        text = "no monitored part of the arm can meet the base, so there is no border"
        return Row("border", "warned", text, {})
    border, top = model.description.config.border, float(MobileBody(model).upper[2])
    empty, ends, numbers = [], [], {}
    for name, cloud in data.clouds.items():
        made = construct_dbb(cloud, border.d_b, border.eps)
        numbers[f"points_{name}"] = float(len(made))
        if not len(made):
            ends.append(f"{name} everywhere")
            continue
        inside = cloud.points_m[cloud.d_m < border.d_b - border.eps][:, 2]
        lowest, highest = float(made.heights[0]), float(made.heights[-1])
        for z in np.arange(_LAYER / 2, top, _LAYER).round(3).tolist():
            reached = np.count_nonzero(np.abs(inside - z) < _LAYER / 2) >= 500
            if reached and len(made.same_height(z, _LAYER / 2)) < 10:
                between = lowest < z - _LAYER and z + _LAYER < highest
                (empty if between else ends).append(f"{name} at z = {z:.2f} m")
    if not any(numbers.values()):
        return Row("border", "failed", "no pair has border points", numbers)
    counts = ", ".join(f"{n.removeprefix('points_')} {c:,.0f} points" for n, c in numbers.items())
    text = f"points at every height that the arm reaches beside the base: {counts}"
    if empty:
        text = f"no points of {', '.join(empty)}"
    if ends:
        where = ", ".join(ends)
        text += f"; the exact offset replaces the points that the arm does not reach: {where}"
    return Row("border", "warned" if empty else "passed", text, numbers)


def run_row(model: RobotModel, data: BorderData, name: str) -> Row:
    """Guide the end-effector towards the base, and compare with a run without avoidance. The
    section *Guiding runs* of docs/other_robots.md has the condition of each outcome.
    """
    from app.control.buffer_watch import buffer_warning
    from app.simulation.run import run_scenario
    from app.simulation.scenarios import scenario_of

    config = model.description.config
    try:
        run = partial(run_scenario, model, data, scenario_of(model.description, name), config)
        guided, bare = run(), run(controller="none", physics="kinematic").figures
    except UnreachableError as error:
        return Row(name, "warned", f"the run cannot start: {error}", {})
    figures, warning = guided.figures, buffer_warning(guided.trace.buffer, config)
    flags = {what: guided.trace.of(quantity) for quantity, what in _TOUCHED.items()}
    steps = [f"{what} in {int(flag.sum())}" for what, flag in flags.items() if flag.any()]
    touched = int(np.any([*flags.values()], axis=0).sum())
    failures, moved = int(figures["solver_failures"]), float(figures["base_displacement_m"])
    near, without = figures["min_clearance_m"], bare["min_clearance_m"]
    numbers = {
        "contacts": float(touched),
        "solver_failures": float(failures),
        "base_displacement_m": moved,
    }
    where = f" ({', '.join(steps)})" if steps else ""
    text = f"{touched} steps with contact{where}, {failures} steps with the fallback command"
    if near is not None:
        numbers |= {"min_clearance_m": float(near), "min_clearance_without_m": float(without)}
        nearest = f"{near:.3f} m ({without:.3f} m without avoidance)"
        text = f"smallest distance to the base {nearest}, base moved by {moved:.3f} m, {text}"
    if touched or failures or (near is not None and near < CLEARANCE):
        return Row(name, "failed", text, numbers)
    if without is None or without >= config.border.d_b / 2:
        return Row(name, "nothing to show", text, numbers)
    outcome: Outcome = "warned" if warning else "passed"
    if moved < (least := GIVES_WAY * config.border.d_b):
        held = bool(warn.holding_warning(warn.carried_ee(model)))
        outcome = "warned" if held else "failed"
        text += f"; the base moves away by less than {least:.3f} m"
        if held:
            text += ", because the arm cannot hold its end-effector in place and avoids the base "
            text += "by itself; with a smaller ee_hold.weight the base moves more"
    return Row(name, outcome, f"{text}; {warning}" if warning else text, numbers)
