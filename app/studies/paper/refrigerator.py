"""§4.2.3: the arm opens a refrigerator whose door comes towards the base (Figures 16 to 18)."""

from __future__ import annotations

from contextlib import closing
from functools import partial

import numpy as np
import pinocchio as pin
import trimesh

from app.simulation.plants.door import BODY, Door, with_door
from app.simulation.scenarios.refrigerator import RefrigeratorScenario
from app.simulation.snapshots import Camera, Photographer, Rgba, Solid
from app.studies.paper.drawing import (
    Drawing,
    Strip,
    framed,
    method_lines,
    placed_meshes,
    snapshot_figure,
    stacked,
)
from app.studies.paper.experiments import DOOR, DOOR_NONE, Run, Sources
from app.studies.style import METHOD_NAMES, level, new_figure, panel_title, time_axis

Array = np.ndarray

METHODS = {"dbb": DOOR, "none": DOOR_NONE}

_TIMES = (0.0, 20.0, 30.0, 40.0)  # [s] of the snapshots: those at which the paper says something
_VIEW = 2.35  # [rad] from the closed door's direction to the camera, on the side of the free edge
_PITCH = 0.55  # [rad]
_DEPTH = 0.60  # [m] of the refrigerator's body
_BODY_COLOUR: Rgba = (0.82, 0.85, 0.88, 1.0)
_DOOR_COLOUR: Rgba = (0.93, 0.95, 0.97, 1.0)
_HANDLE_COLOUR: Rgba = (0.35, 0.38, 0.42, 1.0)
_MAGENTA: Rgba = (0.83, 0.20, 0.62, 1.0)
_SHAPE_COLOUR: Rgba = (0.36, 0.62, 0.80, 1.0)
_FIGURES = (
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


def figure_16(sources: Sources) -> Drawing:
    """The scenario, and the collision models with the door's."""
    run, door = sources.runs[DOOR], _door()
    pose, q_m = run.base_poses[0], run.q_m[0]
    solids = refrigerator(run, 0)
    shapes = collision_shapes(sources, run)
    start = Camera(np.zeros(3), 6.0, *_view(door), 780, 640)
    bodies = placed_meshes(sources.model, pose, q_m)
    camera = framed(start, [mesh for _, mesh in bodies] + [solid.mesh for solid in solids])
    figure = new_figure(4.9)
    grid = figure.subplots(1, 2)
    with closing(Photographer(sources.model)) as photographer:
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
    table = {
        "axis": np.array(["thickness", "width", "height"]),
        "door_m": np.array(door.size),
        "semi_axis_m": np.array(superquadric.semi_axes_m),
    }
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
    view, strips = _view(_door()), []
    for name, experiment in METHODS.items():
        run = sources.runs[experiment]
        look = {"solids": partial(refrigerator, run), "marks": arc(run)}
        strips.append(Strip(name, METHOD_NAMES[name], run, _TIMES, view, **look))
    paths = {strip.name: strip.paths("door_angle_rad") for strip in strips}
    return Drawing(
        "Figure 17: opening a refrigerator",
        "(a) With obstacle avoidance the mobile robot moves back and turns clockwise as the door "
        "comes closer. (b) Without it the door collides with the mobile robot at 30 s.",
        snapshot_figure(sources.model, strips, marks="arc of the door's edge"),
        {"": stacked(paths, "controller")},
        sources.figures(METHODS, _FIGURES),
    )


def figure_18(sources: Sources) -> Drawing:
    """Distance between door and base, and its activation."""
    columns = ("t_s", f"d_lm-{BODY}_m", f"beta_lm-{BODY}")
    parts = {name: {c: sources.runs[e].log[c] for c in columns} for name, e in METHODS.items()}
    figure = new_figure(3.6)
    distance, activation = figure.subplots(1, 2)
    for ax, column in zip((distance, activation), columns[1:], strict=True):
        method_lines(ax, dict(reversed(parts.items())), column)
        time_axis(ax, DOOR.full().duration)
    level(distance, sources.config.border.d_b, "buffer distance $d_b$")
    level(distance, 0.0, "contact")
    distance.set_ylabel("distance [m]")
    activation.set_ylabel(r"activation $\beta$ [–]")
    panel_title(distance, "a", "distance between door and base")
    panel_title(activation, "b", "activation")
    distance.legend(loc="upper right")
    return Drawing(
        "Figure 18: distance of the door and activation",
        "As the distance between door and mobile robot falls below the buffer distance, the "
        "avoidance task is inserted continuously.",
        figure,
        {"": stacked(parts, "controller")},
        sources.figures(METHODS, _FIGURES),
        ["Without avoidance the activation is computed but nothing is inserted."],
    )


def refrigerator(run: Run, k: int) -> list[Solid]:
    """The refrigerator's body, its door and handle, as they stand in a row of the log."""
    door = _door()
    closed, opened = door.pose(0.0), door.pose(float(run.log["door_angle_rad"][k]))
    behind = door.centre + np.array([(door.thickness + _DEPTH) / 2 + 0.005, 0.0, 0.0])
    handle = np.array(
        [
            -door.thickness / 2 - door.handle_reach / 2,
            -door.side * (door.width - door.handle_inset),
            door.handle_height,
        ]
    )
    parts = (
        ((_DEPTH, door.width, door.height), closed, behind, _BODY_COLOUR),
        (door.size, opened, door.centre, _DOOR_COLOUR),
        ((door.handle_reach, 0.025, 0.24), opened, handle, _HANDLE_COLOUR),
    )
    return [
        Solid(trimesh.creation.box(size, (pose * pin.SE3(np.eye(3), at)).homogeneous), colour)
        for size, pose, at, colour in parts
    ]


def collision_shapes(sources: Sources, run: Run) -> list[Solid]:
    """The convex bodies at the run's beginning, the door's among them, as its controller knew."""
    model, door, pose, q_m = sources.model, _door(), run.base_poses[0], run.q_m[0]
    data = model.pin.createData()
    pin.forwardKinematics(model.pin, data, model.configuration(pose, q_m))
    T_ee = pin.updateFramePlacement(model.pin, data, model.ee_frame)
    T_door = T_ee.inverse() * door.pose(float(run.log["door_angle_rad"][0]))
    holding, _ = with_door(model, sources.data, door, T_door)
    return [
        Solid(mesh, _MAGENTA if name == BODY else _SHAPE_COLOUR)
        for name, mesh in placed_meshes(holding, pose, q_m)
    ]


def arc(run: Run) -> Array:
    """(N, 3) [m] where the door's free edge went, on the floor."""
    door = _door()
    angles = np.linspace(0.0, float(run.log["door_angle_rad"].max()), 60)
    edge = np.array([0.0, -door.side * door.width, 0.0])
    return np.array([door.pose(angle).act(edge) for angle in angles])


def _door() -> Door:
    scenario = DOOR.full()
    assert isinstance(scenario, RefrigeratorScenario)
    return scenario.door


def _view(door: Door) -> tuple[float, float]:
    """[rad] yaw and pitch from which the door is seen."""
    return door.yaw - door.side * _VIEW, _PITCH
