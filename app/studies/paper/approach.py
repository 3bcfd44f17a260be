"""Figures 11 to 18 (§4.2, §4.3): the end-effector approaches the base, or opens a refrigerator."""

from contextlib import closing
from functools import partial

import numpy as np
import pinocchio as pin
import trimesh
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from app.simulation.photographer import Camera, Photographer, Rgba, Solid
from app.simulation.plants.door import BODY, Door, drawn_parts, with_door
from app.simulation.run import RunResult
from app.simulation.scenarios.refrigerator import RefrigeratorScenario
from app.strict import Array
from app.studies import style
from app.studies.paper import drawing
from app.studies.paper import experiments as paper
from app.studies.paper.experiments import Sources

_TRACKED = {"dbb": paper.TRACKING, "repulsive": paper.TRACKING_REPULSIVE}
DIRECTIONS = paper.GUIDING["dbb"]
_TIMES = (0.0, 10.0, 20.0, 30.0)  # [s] times of the snapshots of tracking
_SHARES = (0.0, 0.3, 0.6, 1.0)  # [-] times of the snapshots of guiding, as shares of the run
_VIEWS = {"lateral": (0.85, 0.45), "front": (0.70, 0.45)}  # [rad] yaw and pitch of the camera
_PAIRS = ("lm-lEE", "lm-l3")
_MOTION = ("base_displacement_m", "base_yaw_rad", "contacts", "ee_error_final_m")
_DOORS = {"dbb": paper.DOOR, "none": paper.DOOR_NONE}
_DOOR_TIMES = (0.0, 20.0, 30.0, 40.0)  # [s] times of the snapshots, which the paper mentions
_COLOURS: dict[str, Rgba] = {
    "case": (0.82, 0.85, 0.88, 1.0),
    "board": (0.93, 0.95, 0.97, 1.0),
    "handle": (0.35, 0.38, 0.42, 1.0),
    BODY: (0.83, 0.20, 0.62, 1.0),  # magenta
    "other bodies": (0.36, 0.62, 0.80, 1.0),
}
_ACCELERATIONS = {"linear": "linear_mps2", "angular": "angular_radps2"}
_OF_DOOR = (
    *("door_min_distance_m", "door_contacts", "door_met_base_s"),
    *("door_angle_final_rad", "door_opened_80deg_at_s"),
    *("base_back_off_s", "base_yaw_rad", "hand_force_max_n", "radial_error_at_5s_rad"),
)


@style.picture("fig11", "Figure 11: tracking of a line towards the base", *_TRACKED.values())
def figure_11(sources: Sources) -> drawing.Drawing:
    """With the proposed method, a force moves the base back. The end-effector reaches its target
    without a collision. The repulsive method pushes the arm away from the base. This avoids the
    collision, but the end-effector cannot reach the target.
    """
    strips = []
    for name, e in _TRACKED.items():
        text, view = style.METHOD_NAMES[name], _VIEWS["lateral"]
        strips.append(drawing.Strip(name, text, sources.runs[e], _TIMES, view, e.aim()))
    legend = "target and desired motion"
    return drawing.snapshot_drawing(sources.model, strips, "controller", legend, _MOTION)


@style.picture("fig12", "Figure 12: distances and error while tracking", *_TRACKED.values())
def figure_12(sources: Sources) -> drawing.Drawing:
    """(a) Below the buffer distance of 0.15 m, the avoidance task of each method is inserted
    continuously with top priority. (b) Only the repulsive method has a position error.
    """
    distances = {pair: f"d_{pair}_m" for pair in _PAIRS}
    parts = sources.columns(_TRACKED, "t_s", *distances.values(), "ee_error_m")
    table = drawing.stacked(parts, "controller")
    figure, grid = style.new_panels(6.4, 2, 2, sharex=True)
    grid[0][0].sharey(grid[0][1])
    for ax, letter, (pair, column) in zip(grid[0], ("a1", "a2"), distances.items(), strict=True):
        drawing.method_lines(ax, parts, column)
        _distance_panel(ax, sources, letter, style.PAIR_NAMES[pair])
    shown = np.concatenate([table[column] for column in distances.values()])
    grid[0][0].set_ylim(min(0.0, float(shown.min())), 1.1 * float(shown.max()))
    texts = "norm of the position error", "the same on a logarithmic scale"
    for ax, letter, text in zip(grid[1], ("b1", "b2"), texts, strict=True):
        drawing.method_lines(ax, parts, "ee_error_m")
        ax.set_ylabel("position error [m]")
        style.panel_title(ax, letter, text)
        ax.set(xlim=(0.0, paper.TRACKING.scenario.duration), xlabel="time [s]")
    error, detail = grid[1]
    error.set_ylim(-0.02 * error.get_ylim()[1], None)  # a line at 0 does not touch the axis
    detail.set_yscale("log")
    detail.set_ylim(max(1e-9, detail.get_ylim()[0]), None)
    grid[0][0].legend(loc="lower left")
    remark = (
        "The task of the repulsive method prescribes all three components of the closest point's "
        "acceleration, so the end-effector almost stops at the edge of the buffer."
    )
    measured = sources.results(_TRACKED, ("min_clearance_m", "ee_error_max_m", "ee_error_final_m"))
    return drawing.Drawing(figure, {"": table}, measured, [remark])


@style.picture("fig13", "Figure 13: guiding of the end-effector to the base", *DIRECTIONS.values())
def figure_13(sources: Sources) -> drawing.Drawing:
    """(a) If the end-effector is guided from the lateral direction, a force on the base avoids the
    collision. (b) If it is guided from the front, the base moves back while the arm approaches.
    """
    strips = []
    for name, e in DIRECTIONS.items():
        times = [round(share * e.scenario.duration, 1) for share in _SHARES]
        text = f"guided from the {name} direction"
        strips.append(drawing.Strip(name, text, sources.runs[e], times, _VIEWS[name], e.aim()))
    legend = "guiding direction and its end"
    return drawing.snapshot_drawing(sources.model, strips, "direction", legend, _MOTION)


@style.picture("fig14", "Figure 14: distances and activation while guiding", *DIRECTIONS.values())
def figure_14(sources: Sources) -> drawing.Drawing:
    """When the distance of a pair falls below the buffer distance of 0.15 m, the activation of the
    pair rises, and the avoidance task is inserted continuously.
    """
    columns = ("t_s", *(f"d_{p}_m" for p in _PAIRS), *(f"beta_{p}" for p in _PAIRS))
    parts = sources.columns(DIRECTIONS, *columns)
    figure, grid = style.new_panels(6.2, 2, 2, sharex="col", sharey="row")
    for k, (name, part) in enumerate(parts.items()):
        distance, activation = grid[:, k]
        for pair in _PAIRS:
            line = {"color": style.PAIR_COLOURS[pair], "label": style.PAIR_NAMES[pair]}
            distance.plot(part["t_s"], part[f"d_{pair}_m"], **line)
            activation.plot(part["t_s"], part[f"beta_{pair}"], **line)
        _distance_panel(distance, sources, f"a{k + 1}", f"distances, {name} direction")
        style.panel_title(activation, f"b{k + 1}", f"activation, {name} direction")
        activation.set(xlim=(0.0, DIRECTIONS[name].scenario.duration), xlabel="time [s]")
    grid[0][1].set_ylabel("")
    grid[0][0].set_ylim(0.0, None)
    grid[1][0].set(ylabel=r"activation $\beta$ [–]", ylim=(-0.02, 1.02))
    _legend_below(figure, grid[0][0])
    keys = ("min_clearance_m", "contacts", "activation_max", "ee_error_final_m")
    table = drawing.stacked(parts, "direction")
    return drawing.Drawing(figure, {"": table}, sources.results(DIRECTIONS, keys))


@style.picture("fig15", "Figure 15: desired accelerations of the base in guiding", *paper.COMPARED)
def figure_15(sources: Sources) -> drawing.Drawing:
    """The desired linear (a) and angular (b) accelerations of the base, multiplied by activation,
    are smooth, without chattering or vibration, because the task transition is continuous.
    """
    runs = {
        f"{name}, {method}": (sources.runs[experiment], method)
        for method, by_direction in paper.GUIDING.items()
        for name, experiment in by_direction.items()
    }
    tables = {name: _avoidance_columns(*run) for name, run in runs.items()}
    figure, grid = style.new_panels(6.2, 2, 2, sharex="col", sharey="row")
    for k, (name, experiment) in enumerate(DIRECTIONS.items()):
        parts = {method: tables[f"{name}, {method}"] for method in reversed(paper.GUIDING)}
        for ax, letter, kind in zip(grid[:, k], "ab", _ACCELERATIONS, strict=True):
            drawing.method_lines(ax, parts, _ACCELERATIONS[kind], linewidth=1.6)
            style.panel_title(ax, f"{letter}{k + 1}", f"{kind}, {name} direction")
        grid[1][k].set(xlim=(0.0, experiment.scenario.duration), xlabel="time [s]")
    grid[0][0].set_ylabel(r"$\beta_m\,\dot v_d$ [m/s²]")
    grid[1][0].set_ylabel(r"$\beta_m\,\dot\omega_d$ [rad/s²]")
    _legend_below(figure, grid[0][0])
    return drawing.Drawing(
        figure,
        {"": drawing.stacked(tables, "direction and controller")},
        {name: _smoothness(*run) for name, run in runs.items()},
        [
            "With a border of points, as in the paper, the acting point jumps from point to point, "
            "and the accelerations jump with it. The default here is a continuous surface.",
            "The repulsive method accelerates only the arm; its curve is the commanded "
            "acceleration of the base.",
        ],
    )


def _smoothness(run: RunResult, method: str) -> dict[str, object]:
    """The results of a run on the smoothness of base accelerations and torques, by their keys."""
    # The repulsive method has no base acceleration of avoidance.
    kinds = ("base",) if method == "repulsive" else ("avoidance", "base")
    changes = ("acceleration_jump_max", "acceleration_sign_changes")
    keys = [f"{kind}_{change}" for kind in kinds for change in changes]
    keys += ["torque_jump_max_nm", "torque_rate_sign_changes"]
    return {key: run.figures[key] for key in keys}


def _avoidance_columns(run: RunResult, method: str) -> drawing.Table:
    """Times and base accelerations: of avoidance or, for the repulsive method, commanded."""
    kind = "base" if method == "repulsive" else "avoidance"
    return {
        "t_s": run.trace["t_s"],
        _ACCELERATIONS["linear"]: run.trace[f"{kind}_a_mps2"],
        _ACCELERATIONS["angular"]: run.trace[f"{kind}_aw_radps2"],
    }


def _distance_panel(ax: Axes, sources: Sources, letter: str, title: str) -> None:
    style.level(ax, sources.config.border.d_b, "buffer distance $d_b$")
    ax.set_ylabel("distance [m]")
    style.panel_title(ax, letter, title)


def _legend_below(figure: Figure, ax: Axes) -> None:
    handles, labels = ax.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))


@style.picture("fig16", "Figure 16: the refrigerator", paper.DOOR)
def figure_16(sources: Sources) -> drawing.Drawing:
    """The end-effector is fixed to the door, which can collide with the mobile base. The
    collision model of the door is a hyper-ellipsoid.
    """
    run, door = sources.runs[paper.DOOR], _door()
    pose, q_m = run.trace.of("base_pose")[0], run.trace.of("q_m")[0]
    solids, shapes = refrigerator(run, 0), collision_shapes(sources, run)
    start = Camera(np.zeros(3), 6.0, *_door_view(door), 780, 640)
    bodies = sources.model.placed_meshes(pose, q_m)
    camera = drawing.framed(start, [mesh for _, mesh in bodies] + [solid.mesh for solid in solids])
    figure, grid = style.new_panels(4.9, 1, 2)
    texts = ("opening a refrigerator", "collision models, magenta for the door")
    with closing(Photographer(sources.model)) as photographer:
        for ax, letter, text, shown in zip(grid, "ab", texts, (solids, shapes), strict=True):
            shot = photographer.take(pose, q_m, camera, shown, robot=shown is solids)
            drawing.show_picture(ax, shot, camera)
            style.panel_title(ax, letter, text)
    body = door.superquadric(pin.SE3.Identity())
    sides = zip(("thickness", "width", "height"), door.size, body.semi_axes_m, strict=True)
    measured = {"door_width_m": door.width, "hinge": door.hinge, "hinge_friction_nm": door.friction}
    measured |= {"exponent_e1": body.e1, "exponent_e2": body.e2}
    table = drawing.table_of(("axis", "door_m", "semi_axis_m"), sides)
    remark = "The CSV has the door's sides and the semi-axes of its hyper-ellipsoid."
    return drawing.Drawing(figure, {"": table}, measured, [remark])


@style.picture("fig17", "Figure 17: opening a refrigerator", *_DOORS.values())
def figure_17(sources: Sources) -> drawing.Drawing:
    """(a) With obstacle avoidance the mobile base moves back and turns clockwise while the door
    approaches. (b) Without avoidance the door collides with the mobile base at 30 s.
    """
    view, strips = _door_view(_door()), []
    for name, experiment in _DOORS.items():
        run, text = sources.runs[experiment], style.METHOD_NAMES[name]
        look = {"solids": partial(refrigerator, run), "marks": arc(run)}
        strips.append(drawing.Strip(name, text, run, _DOOR_TIMES, view, **look))
    legend, column = "arc of the door's edge", "door_angle_rad"
    return drawing.snapshot_drawing(sources.model, strips, "controller", legend, _OF_DOOR, column)


@style.picture("fig18", "Figure 18: distance of the door and activation", *_DOORS.values())
def figure_18(sources: Sources) -> drawing.Drawing:
    """When the distance between door and mobile base falls below the buffer distance, the
    avoidance task is inserted continuously.
    """
    columns = ("t_s", f"d_lm-{BODY}_m", f"beta_lm-{BODY}")
    parts = sources.columns(_DOORS, *columns)
    figure, (distance, activation) = style.new_panels(3.6, 1, 2)
    for ax, column in zip((distance, activation), columns[1:], strict=True):
        drawing.method_lines(ax, dict(reversed(parts.items())), column)
        ax.set(xlim=(0.0, paper.DOOR.scenario.duration), xlabel="time [s]")
    _distance_panel(distance, sources, "a", "distance between door and base")
    style.level(distance, 0.0, "contact")
    activation.set_ylabel(r"activation $\beta$ [–]")
    style.panel_title(activation, "b", "activation")
    distance.legend(loc="upper right")
    table, measured = drawing.stacked(parts, "controller"), sources.results(_DOORS, _OF_DOOR)
    remark = "Without avoidance the activation is computed, but no task is inserted."
    return drawing.Drawing(figure, {"": table}, measured, [remark])


def refrigerator(run: RunResult, k: int) -> list[Solid]:
    """The refrigerator's case, door and handle, at the door angle in row k of the run."""
    parts = drawn_parts(_door(), float(run.trace["door_angle_rad"][k]))
    return [
        Solid(trimesh.creation.box(size, T.homogeneous), _COLOURS[name])
        for name, (size, T) in parts.items()
    ]


def collision_shapes(sources: Sources, run: RunResult) -> list[Solid]:
    """The controller's convex bodies at the start of the run, including the body of the door."""
    model, door = sources.model, _door()
    pose, q_m = run.trace.of("base_pose")[0], run.trace.of("q_m")[0]
    data = model.pin.createData()
    pin.forwardKinematics(model.pin, data, model.configuration(pose, q_m))
    T_ee = pin.updateFramePlacement(model.pin, data, model.ee_frame)
    T_door = T_ee.inverse() * door.pose(float(run.trace["door_angle_rad"][0]))
    holding, _ = with_door(model, sources.data, door, T_door)
    return [
        Solid(mesh, _COLOURS[name if name == BODY else "other bodies"])
        for name, mesh in holding.placed_meshes(pose, q_m)
    ]


def arc(run: RunResult) -> Array:
    """(N, 3) [m] path of the door's free edge on the floor, from 0 to the largest door angle."""
    door = _door()
    angles = np.linspace(0.0, float(run.trace["door_angle_rad"].max()), 60)
    edge = np.array([0.0, -door.side * door.width, 0.0])
    return np.array([door.pose(angle).act(edge) for angle in angles])


def _door() -> Door:
    scenario = paper.DOOR.scenario
    assert isinstance(scenario, RefrigeratorScenario)
    return scenario.door


def _door_view(door: Door) -> tuple[float, float]:
    """[rad] yaw and pitch of a camera that looks at the closed door from the free edge's side."""
    return door.yaw - door.side * 2.35, 0.55
