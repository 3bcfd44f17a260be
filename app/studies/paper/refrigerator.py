"""§4.2.3: the arm opens a refrigerator whose door comes towards the base (Figures 16 to 18)."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pinocchio as pin
import trimesh

from app.robot.meshes import shape_mesh
from app.robot.model import RobotModel
from app.simulation.plants.door import BODY, Door, with_door
from app.simulation.scenarios.refrigerator import RefrigeratorScenario
from app.simulation.snapshots import Camera, Photographer, Rgba, Solid
from app.studies.drawing import Drawing, Table, stacked
from app.studies.paper.experiments import Experiment, Run, Sources
from app.studies.paper.motion import extent
from app.studies.paper.panels import Strip, legend_of, path_columns, snapshot_figure
from app.studies.style import (
    METHOD_COLOURS,
    METHOD_NAMES,
    level,
    new_figure,
    panel_title,
    time_axis,
)

Array = np.ndarray

DBB = Experiment("refrigerator", "dbb")
NONE = Experiment("refrigerator", "none")
NEEDS = (DBB, NONE)

_TIMES = (0.0, 20.0, 30.0, 40.0)  # [s] of the snapshots: those at which the paper says something
_VIEW = 2.35  # [rad] from the closed door's direction to the camera, on the side of the free edge
_PITCH = 0.55  # [rad]
_DEPTH = 0.60  # [m] of the refrigerator's body
_BODY_COLOUR: Rgba = (0.82, 0.85, 0.88, 1.0)
_DOOR_COLOUR: Rgba = (0.93, 0.95, 0.97, 1.0)
_HANDLE_COLOUR: Rgba = (0.35, 0.38, 0.42, 1.0)
_MAGENTA: Rgba = (0.83, 0.20, 0.62, 1.0)
_SHAPE_COLOUR: Rgba = (0.36, 0.62, 0.80, 1.0)


def figure_16(sources: Sources) -> Drawing:
    """The scenario, and the collision models with the door's."""
    run, door = sources.runs[DBB], _door(DBB)
    pose, q_m = run.base_poses[0], run.q_m[0]
    solids = refrigerator(door, float(run.log["door_angle_rad"][0]))
    shapes = collision_shapes(sources, run, door)
    corners = [np.asarray(solid.mesh.bounding_box.vertices) for solid in solids]
    points = np.concatenate([extent(sources.model, pose, q_m), *corners])
    start = Camera(points.mean(axis=0), 6.0, _yaw(door), _PITCH, 780, 640)
    camera = start.framing(points, 0.04)
    figure = new_figure(4.9)
    grid = figure.subplots(1, 2)
    with Photographer(sources.model) as photographer:
        pictures = (
            photographer.take(pose, q_m, camera, solids),
            photographer.take(pose, q_m, camera, shapes, robot=False),
        )
    texts = ("opening a refrigerator", "collision models; the door's in magenta")
    for ax, letter, text, picture in zip(grid, "ab", texts, pictures, strict=True):
        ax.imshow(picture.rgb)
        ax.set_axis_off()
        panel_title(ax, letter, text)
    superquadric = door.superquadric(pin.SE3.Identity())
    table = Table(
        {
            "axis": np.array(["thickness", "width", "height"]),
            "door_m": np.array(door.size),
            "semi_axis_m": np.array(superquadric.semi_axes_m),
        }
    )
    return Drawing(
        "Figure 16: the refrigerator",
        "The end-effector holds the door without any relative motion; the door, modelled by a "
        "hyper-ellipsoid, can collide with the mobile robot.",
        figure,
        {"": table},
        {
            "door_width_m": door.width,
            "hinge": door.hinge,
            "hinge_friction_nm": door.friction,
            "exponent_e1": superquadric.e1,
            "exponent_e2": superquadric.e2,
        },
        ["The CSV holds the door's sides and the semi-axes of its hyper-ellipsoid."],
    )


def figure_17(sources: Sources) -> Drawing:
    """Snapshots with and without avoidance."""
    paths, strips = {}, []
    for letter, experiment in zip("ab", NEEDS, strict=True):
        run, door = sources.runs[experiment], _door(experiment)
        paths[letter] = Table(
            path_columns(sources.model, run) | {"door_angle_rad": run.log["door_angle_rad"][::10]}
        )
        strips.append(
            Strip(
                letter,
                METHOD_NAMES[experiment.controller],
                run,
                _TIMES,
                _yaw(door),
                _PITCH,
                solids=_solids_of(run, door),
                marks=arc(door, run),
            )
        )
    legend = legend_of(marks="arc of the door's edge")
    parts = {e.controller: paths[x].columns for x, e in zip("ab", NEEDS, strict=True)}
    return Drawing(
        "Figure 17: opening a refrigerator",
        "(a) With obstacle avoidance the mobile robot moves back and turns clockwise as the door "
        "comes closer. (b) Without it the door collides with the mobile robot at 30 s.",
        snapshot_figure(sources.model, strips, paths, legend),
        {"": stacked(parts, "controller")},
        {e.controller: _figures(sources.runs[e]) for e in NEEDS},
    )


def figure_18(sources: Sources) -> Drawing:
    """Distance between door and base, and its activation."""
    columns = ("t_s", f"d_lm-{BODY}_m", f"beta_lm-{BODY}")
    parts = {e.controller: {c: sources.runs[e].log[c] for c in columns} for e in NEEDS}
    figure = new_figure(3.6)
    grid = figure.subplots(1, 2)
    for name, part in reversed(parts.items()):
        style = {"color": METHOD_COLOURS[name], "label": METHOD_NAMES[name]}
        for ax, column in zip(grid, columns[1:], strict=True):
            ax.plot(part["t_s"], part[column], **style)
    level(grid[0], sources.config.border.d_b, "buffer distance $d_b$")
    level(grid[0], 0.0, "contact")
    grid[0].set_ylabel("distance [m]")
    grid[1].set_ylabel(r"activation $\beta$ [–]")
    panel_title(grid[0], "a", "distance between door and base")
    panel_title(grid[1], "b", "activation")
    for ax in grid:
        time_axis(ax, DBB.full().duration)
    grid[0].legend(loc="upper right")
    return Drawing(
        "Figure 18: distance of the door and activation",
        "As the distance between door and mobile robot falls below the buffer distance, the "
        "avoidance task is inserted continuously.",
        figure,
        {"": stacked(parts, "controller")},
        {e.controller: _figures(sources.runs[e]) for e in NEEDS},
        ["Without avoidance the activation is computed but nothing is inserted."],
    )


def refrigerator(door: Door, angle: float) -> list[Solid]:
    """The refrigerator's body and its door, open by an angle [rad]."""
    closed, opened = door.pose(0.0), door.pose(angle)
    size = (_DEPTH, door.width, door.height)
    behind = door.centre + np.array([(door.thickness + _DEPTH) / 2 + 0.005, 0.0, 0.0])
    handle = np.array(
        [
            -door.thickness / 2 - door.handle_reach / 2,
            -door.side * (door.width - door.handle_inset),
            door.handle_height,
        ]
    )
    return [
        Solid(_box(size, closed, behind), _BODY_COLOUR),
        Solid(_box(door.size, opened, door.centre), _DOOR_COLOUR),
        Solid(_box((door.handle_reach, 0.025, 0.24), opened, handle), _HANDLE_COLOUR),
    ]


def collision_shapes(sources: Sources, run: Run, door: Door) -> list[Solid]:
    """The convex bodies at the run's beginning, as its controller knew them."""
    model = _holding(sources, run, door)
    data, placed = model.pin.createData(), pin.GeometryData(model.geometry)
    q = model.configuration(run.base_poses[0], run.q_m[0])
    pin.updateGeometryPlacements(model.pin, data, model.geometry, placed, q)
    return [
        Solid(
            shape_mesh(shape).apply_transform(placed.oMg[i].homogeneous),
            _MAGENTA if body.name == BODY else _SHAPE_COLOUR,
        )
        for body in model.description.bodies
        for i, shape in zip(model.shape_ids[body.name], body.shapes, strict=True)
    ]


def arc(door: Door, run: Run) -> Array:
    """(N, 3) [m] where the door's free edge went, on the floor."""
    angles = np.linspace(0.0, float(run.log["door_angle_rad"].max()), 60)
    edge = np.array([0.0, -door.side * door.width, 0.0])
    return np.array([door.pose(angle).act(edge) for angle in angles])


def _holding(sources: Sources, run: Run, door: Door) -> RobotModel:
    """The robot with the door as its last body, from the run's first row."""
    model = sources.model
    data = model.pin.createData()
    pin.forwardKinematics(model.pin, data, model.configuration(run.base_poses[0], run.q_m[0]))
    T_ee = pin.updateFramePlacement(model.pin, data, model.ee_frame)
    angle = float(run.log["door_angle_rad"][0])
    return with_door(model, sources.data, door, T_ee.inverse() * door.pose(angle))[0]


def _door(experiment: Experiment) -> Door:
    scenario = experiment.full()
    assert isinstance(scenario, RefrigeratorScenario)
    return scenario.door


def _yaw(door: Door) -> float:
    return door.yaw - door.side * _VIEW


def _solids_of(run: Run, door: Door) -> Callable[[int], Sequence[Solid]]:
    return lambda k: refrigerator(door, float(run.log["door_angle_rad"][k]))


def _box(size: Sequence[float], pose: pin.SE3, centre: Array) -> trimesh.Trimesh:
    at = pose * pin.SE3(np.eye(3), np.asarray(centre, dtype=float))
    return trimesh.creation.box(size).apply_transform(at.homogeneous)


def _figures(run: Run) -> dict[str, object]:
    keys = (
        "door_min_distance_m",
        "door_contacts",
        "door_met_base_s",
        "door_angle_final_rad",
        "door_opened_80deg_at_s",
        "base_back_off_s",
        "base_yaw_rad",
        "hand_force_max_n",
        "radial_error_at_5s_rad",
    )
    return {key: run.figures[key] for key in keys}
