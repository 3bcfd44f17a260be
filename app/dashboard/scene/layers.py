"""Layers that explain the motion; each layer is a function that draws a part of a snapshot."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from app.dashboard.scene import colours
from app.dashboard.scene.canvas import HEAD_LENGTH, ROOT, Canvas, in_world
from app.dashboard.scene.colours import Rgb, linear
from app.dashboard.scene.legend import METRES_PER_ACCELERATION, METRES_PER_NEWTON
from app.dashboard.verdict import COLOURS, Verdict
from app.dashboard.view import View
from app.robot.bases.kind import Axis, planar
from app.simulation.plants.door import DoorView, drawn_parts
from app.simulation.trace.metrics import OPENED
from app.simulation.trace.snapshot import PairReading, Snapshot
from app.simulation.trace.words import METHOD_WORDS, millimetres
from app.strict import Array

_LABEL_LIFT = np.array([0.0, 0.0, 0.07])  # [m] above a point, clear of the acting points
_LOOKS = ("solid", "violet", "teal")  # names for the robot and for the colours `colours.GHOSTS`
SAME = 0.01  # [m or rad] links of a ghost with smaller differences from the robot are hidden
_LEAST_FORCE = 0.5  # [N] weaker forces are not drawn
_LEAST_ACCELERATION = 0.02  # [m/s²], [rad/s²] smaller values are not drawn
_MOST_ARC = np.deg2rad(300.0)  # [rad] largest arc
_ARC_POINTS = 24
_POINTS: dict[str, Rgb] = {"p_n": (240, 240, 245), "p_t": (32, 190, 200), "p_act": colours.ACTING}
_HANDLE: Rgb = (70, 76, 84)
_DOOR_COLOURS: dict[str, tuple[Rgb, float | None]] = {
    "case": ((190, 196, 204), 0.5),
    "board": ((225, 228, 232), None),
    "handle": (_HANDLE, None),
}


def draw_distances(
    canvas: Canvas, snapshot: Snapshot, verdict: Verdict, view: View, spoken: Mapping[str, str]
) -> None:
    """Draw lines between closest points, thick inside the buffer, and labels by `view.labels`."""
    d_b, pairs = snapshot.d_b, snapshot.pairs
    shades = linear(np.array([COLOURS[state] for state in verdict.pairs]))
    shades = np.repeat(shades[:, None, :], 2, axis=1)
    for kind, inside, pixels in (("outside", False, 1.5), ("inside", True, 4.0)):
        canvas.segments(f"/distances/{kind}", segments(pairs, d_b, inside=inside), shades, pixels)
    for pair in pairs:
        if view.labels == "all" or (view.labels == "active" and pair.d < d_b):
            # Not between base and arm, because the acting points with their labels are there.
            place = pair.p_a + _LABEL_LIFT if pair.mobile else (pair.p_a + pair.p_b) / 2
            overlap = "" if pair.d >= 0.0 else " overlap"
            text = f"{spoken[pair.name]} {millimetres(abs(pair.d))}{overlap}"
            canvas.label(f"/distances/label_{pair.name}", place, text)
        if view.labels == "all" and pair.d < d_b:
            node = f"/distances/{pair.name}"
            for name, point in (("p_a", pair.p_a), ("p_b", pair.p_b)):
                canvas.point(f"{node}/{name}", point, COLOURS["near"], 0.009)
                if pair is snapshot.nearest:  # labels of all pairs would overlap
                    canvas.label(f"{node}/{name}_label", point, name)


def segments(pairs: Sequence[PairReading], d_b: float, *, inside: bool) -> Array:
    """Return the segments (N, 2, 3) [m] between the closest points of the pairs.

    If `inside`, the segments of all pairs outside the buffer d_b [m] have length 0. Otherwise, the
    segments of all pairs inside the buffer have length 0.
    """
    ends = [(p.p_a, p.p_b if (p.d < d_b) == inside else p.p_a) for p in pairs]
    return np.array(ends, dtype=float).reshape(-1, 2, 3)


def draw_acting_points(canvas: Canvas, snapshot: Snapshot, view: View, top: float) -> None:
    """Draw p_n, p_t, p_act and the force f, unless f is small; `top` [m] is the base's height."""
    for reading in snapshot.acting:
        size = np.linalg.norm(reading.f)
        if size < _LEAST_FORCE:
            continue
        node = f"/acting/{reading.name}"
        for name, colour in _POINTS.items():
            canvas.point(f"{node}/{name}", getattr(reading, name), colour, 0.011)
            if view.labels == "all" and name != "p_act":
                canvas.label(f"{node}/{name}_label", getattr(reading, name), name)
        # The arrow ends at p_act, because the base would hide an arrow that starts there. Below the
        # base's top, the arm would hide it: then it is above the top.
        x, y, z = reading.p_act
        end = np.array([x, y, max(z, top + 0.08)])  # [m]
        start = end - METRES_PER_NEWTON * reading.f
        canvas.arrow(f"{node}/force", start, end, colours.ACTING)
        canvas.lines(f"{node}/stem", [np.array([reading.p_act, end])], colours.ACTING, 2.0)
        force = f"base pushed {size:.0f} N"
        text = f"p_act  {force}" if view.labels == "all" else force
        canvas.label(f"{node}/p_act_label", start, text)


def draw_motion(canvas: Canvas, snapshot: Snapshot, axes: Sequence[Axis], top: float) -> None:
    """Draw the people's force on the end-effector, and the base's commanded acceleration."""
    force = snapshot.hand_force
    if snapshot.hand_target is not None and np.linalg.norm(force) >= _LEAST_FORCE:
        tip = snapshot.p_ee + METRES_PER_NEWTON * force
        canvas.arrow("/person", snapshot.p_ee, tip, colours.PERSON)
    draw_acceleration(canvas, ROOT, snapshot.base_acceleration, axes, top)


def draw_acceleration(
    canvas: Canvas, node: str, acceleration: Array, axes: Sequence[Axis], top: float
) -> None:
    """Draw an acceleration (n_b,) as arrow and arc in the frame of `node`, above z = `top` [m]."""
    forward, left, w = planar(axes, acceleration)
    over = np.array([0.0, 0.0, top + 0.06])  # [m]
    if np.hypot(forward, left) > _LEAST_ACCELERATION:
        along = METRES_PER_ACCELERATION * np.array([forward, left, 0.0])
        canvas.arrow(f"{node}/v", over, over + along, colours.ACCELERATION)
    if abs(w) > _LEAST_ACCELERATION:
        angle = float(np.clip(0.4 * w, -_MOST_ARC, _MOST_ARC))  # 0.4 rad is 1 rad/s²
        along = np.linspace(0.0, angle, _ARC_POINTS)
        circle = np.column_stack([np.cos(along), np.sin(along), np.zeros(len(along))])
        points = over + 0.22 * circle  # [m] radius
        canvas.lines(f"{node}/w_arc", [points], colours.ACCELERATION, 4.0)
        ahead = points[-1] - points[-2]  # the arrow is as long as its head
        tip = points[-1] + HEAD_LENGTH / max(float(np.linalg.norm(ahead)), 1e-9) * ahead
        canvas.arrow(f"{node}/w_head", points[-1], tip, colours.ACCELERATION)


def draw_pulls(canvas: Canvas, snapshot: Snapshot) -> None:
    """Draw a line from each pulled point to its target, and the force as a label."""
    for i, pull in enumerate(snapshot.pulls):
        ends = np.array([pull.point, pull.target])
        if np.linalg.norm(ends[1] - ends[0]) > 0.002:  # [m]
            canvas.lines(f"/pull/{i}", [ends], colours.PERSON, 3.0)
            force = float(np.linalg.norm(pull.force))
            if force >= _LEAST_FORCE:
                canvas.label(f"/pull/label_{i}", ends.mean(axis=0), f"pull {force:.0f} N")


def draw_names(canvas: Canvas, snapshot: Snapshot, at: Array) -> None:
    """Label robots if a ghost's pose or posture differs; `at` (3,) [m] is in each base's frame."""
    base, q_m = snapshot.base_pose, snapshot.q_m
    apart = [np.append(ghost.base_pose - base, ghost.q_m - q_m) for ghost in snapshot.ghosts]
    if all(np.abs(each).max() < SAME for each in apart):
        return
    robots = zip((snapshot, *snapshot.ghosts), standings(snapshot), strict=True)
    for i, (robot, (name, near)) in enumerate(robots):
        place = in_world(robot.base_pose, at)
        canvas.label(f"/names/{i}", place, f"{_LOOKS[i]}, {name}: {near}")


def standings(snapshot: Snapshot) -> Iterator[tuple[str, str]]:
    """Yield the words for method and clearance of the robot, then of each ghost."""
    part = "arm" if snapshot.door is None else "arm or door"
    for robot in (snapshot, *snapshot.ghosts):
        d, near = robot.clearance, millimetres(abs(robot.clearance))
        text = f"{part} overlaps its base by {near}" if d < 0.0 else f"{part} {near} from its base"
        yield METHOD_WORDS.get(robot.controller, robot.controller), text


def draw_door(canvas: Canvas, view: DoorView) -> None:
    """Draw the refrigerator, its hinge, and the opening angle with the goal."""
    door = view.door
    for name, (size, T) in drawn_parts(door, view.angle).items():
        colour, opacity = _DOOR_COLOURS[name]
        canvas.box(f"/door/{name}", T, size, colour, opacity)
    top = np.array([0.0, 0.0, door.bottom + door.height + 0.05])  # [m]
    hinge = door.pose(0.0).translation
    canvas.lines("/door/hinge", [np.array([hinge, hinge + top])], colours.ACTING, 4.0)
    radius = np.array([0.0, -door.side * 0.30, 0.0])  # [m]
    arcs = (("goal", OPENED, _HANDLE), ("open", view.angle, COLOURS["giving way"]))
    for name, angle, colour in arcs:
        arc = [door.pose(a).act(top + radius) for a in np.linspace(0, angle, _ARC_POINTS)]
        canvas.lines(f"/door/{name}", [np.array([hinge + top, *arc, hinge + top])], colour, 3.0)
    text = f"{np.degrees(view.angle):.0f}° of {np.degrees(OPENED):.0f}°"
    canvas.label("/door/angle", door.pose(view.angle / 2).act(top + 1.3 * radius), text)
