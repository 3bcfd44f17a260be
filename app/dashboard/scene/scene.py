"""Scene: the robot and all layers, and the drawing of a snapshot."""

from itertools import zip_longest
from typing import Any

import numpy as np
import pinocchio as pin
import viser

from app.dashboard.scene import layers
from app.dashboard.scene.borders import DrawnBorders
from app.dashboard.scene.canvas import ROOT, Canvas, Lens, add_mesh, to_viser
from app.dashboard.scene.colours import GHOSTS, TRAIL_BASE, TRAIL_EE, Rgb
from app.dashboard.scene.robot import RobotParts, Visual
from app.dashboard.shared import SharedState
from app.dashboard.verdict import Verdict, judge
from app.dashboard.view import View
from app.simulation.trace.snapshot import GhostReading, Snapshot
from app.strict import Array

_TRAILS = {"base": TRAIL_BASE, "end-effector": TRAIL_EE}


class RobotScene:
    """A robot in a scene: frames move, and meshes below them are sent at first and by `dress`."""

    def __init__(
        self, scene: viser.SceneApi, parts: RobotParts, ghost: int | None = None, *, light: bool
    ) -> None:
        """Send one robot's meshes; ghost number `ghost` is translucent, without convex bodies."""
        self._parts, self._scene, self._model = parts, scene, parts.kinematics.model
        self._ghost = None if ghost is None else GHOSTS[ghost % len(GHOSTS)]
        self._path = ROOT if ghost is None else f"/ghost_{ghost}"
        self.root = scene.add_frame(self._path, show_axes=False)
        bodies = parts.bodies if ghost is None else []
        moving = sorted({visual.joint for visual in (*parts.visuals, *bodies)})
        self._frames = {
            joint: scene.add_frame(node_of(self._model, joint, self._path), show_axes=False)
            for joint in moving
        }
        self.links: list[tuple[int, viser.MeshHandle]] = []  # joint and handle of each visual mesh
        self.dress(light=light)
        self._bodies = [self._add(body, body.colour, 0.28) for body in bodies]
        self.show(meshes=True, bodies=False)

    def dress(self, *, light: bool) -> None:
        """Replace `links` by meshes with few faces (`light`) or by the usual meshes."""
        for _, handle in self.links:
            handle.remove()
        opacity = None if self._ghost is None else 0.30
        self.links = [
            (visual.joint, self._add(visual, self._ghost or visual.colour, opacity, light))
            for visual in (self._parts.light_visuals if light else self._parts.visuals)
        ]

    def show(self, *, meshes: bool, bodies: bool) -> None:
        for _, handle in self.links:
            handle.visible = meshes
        for handle in self._bodies:
            handle.visible = bodies

    def update(self, robot: Snapshot | GhostReading) -> None:
        """Move the frames to base pose, posture and wheel angles of a robot."""
        x, y, phi = robot.base_pose
        root = pin.SE3(pin.utils.rotate("z", float(phi)), np.array([x, y, 0.0]))
        poses = self._parts.kinematics.update(robot.q_m, robot.wheel_angles)
        self._placed = root, poses
        self.root.position, self.root.wxyz = to_viser(root)
        for joint, frame in self._frames.items():
            frame.position, frame.wxyz = to_viser(poses[joint])

    def hide_links_near(self, other: "RobotScene") -> None:
        """Hide each link that nearly coincides with the same link of `other`; show all others."""
        for joint, frame in self._frames.items():
            apart = other.world_pose(joint).actInv(self.world_pose(joint))
            rolls = joint in self._parts.kinematics.wheels
            turned = 0.0 if rolls else np.abs(pin.log3(apart.rotation)).max()
            frame.visible = bool(max(np.abs(apart.translation).max(), turned) > layers.SAME)

    def world_pose(self, joint: int) -> pin.SE3:
        """Return the pose T_world_joint of a joint at the last `update`."""
        root, poses = self._placed
        return root * poses[joint]

    def _add(
        self, visual: Visual, colour: Rgb, opacity: float | None, light: bool = False
    ) -> viser.MeshHandle:
        node = f"{node_of(self._model, visual.joint, self._path)}/{visual.name}"
        look = {"color": colour, "opacity": opacity, "cast_shadow": opacity is None and not light}
        look["receive_shadow"] = False  # shadows would darken the whole base
        return add_mesh(self._scene, node, visual.mesh, visual.placement, **look)


def node_of(model: pin.Model, joint: int, root: str = ROOT) -> str:
    """Return the scene node of a joint of the drawn model; joint 0 is the root's fixed node."""
    return f"{root}/{model.names[joint] if joint else 'fixed'}"


class Scene:
    """The robot and the layers that explain its motion, without widgets."""

    def __init__(self, scene: viser.SceneApi, data: SharedState, view: View) -> None:
        """Send all constant objects; each drawing reads `view`."""
        self._scene, self._data, self._view = scene, data, view
        self.robot = RobotScene(scene, data.parts, light=view.light)
        self._ghosts: list[RobotScene] = []
        self.canvas = Canvas(scene)
        self.border = DrawnBorders(scene, data.borders, data.model)
        self._trails: dict[str, Array] = {}
        self._dark, self._light = view.dark, view.light
        self._light_up()

    def draw(self, snapshot: Snapshot, *, texts: bool, lens: Lens | None = None) -> Verdict:
        """Draw a snapshot except the coloured borders, and return its verdict.

        The texts of labels, and the trails, are updated only if `texts`. The lens determines the
        positions of labels and the point under the pointer.
        """
        view = self._view
        dark, light = view.dark, view.light  # the viewer can change them meanwhile
        if (self._dark, self._light) != (dark, light):
            for robot in (self.robot, *self._ghosts) if self._light != light else ():
                robot.dress(light=light)
            self._dark, self._light = dark, light
            self._light_up()
        self.robot.show(meshes=view.meshes, bodies=view.bodies)
        self.robot.update(snapshot)
        self._draw_ghosts(snapshot)
        if texts and view.trails:
            self._trails = {name: t.until(snapshot.t) for name, t in self._data.tracks.items()}
        verdict = judge(snapshot, self._data.spoken)
        with self.canvas.picture(texts=texts, lens=lens, t=snapshot.t):
            self._draw_layers(snapshot, verdict)
            self.border.draw_probe(self.canvas, snapshot, lens)
        return verdict

    def _light_up(self) -> None:
        scene, light, dark = self._scene, self._light, self._dark
        scene.configure_default_lights(enabled=True, cast_shadow=not light)
        scene.configure_environment_map(None)  # reflections double the time of software rendering
        sky: Any = {"sky_color": (255, 255, 255), "ground_color": (120, 125, 135)}
        scene.add_light_hemisphere("/lights/sky", intensity=1.2, **sky)
        scene.add_grid(
            "/floor",
            width=8.0,
            height=8.0,
            infinite_grid=True,
            cell_size=0.1,
            cell_color=(58, 62, 68) if dark else (222, 225, 230),
            section_color=(98, 104, 114) if dark else (176, 182, 192),
            cell_thickness=0.8,
            section_thickness=1.2,
            fade_distance=9.0,
            fade_strength=1.5,
            shadow_opacity=0.0 if light else 0.35 if dark else 0.22,
        )

    def _draw_layers(self, snapshot: Snapshot, verdict: Verdict) -> None:
        view, canvas, top = self._view, self.canvas, self._data.borders.top
        if view.slice:
            self.border.draw_slice(canvas, snapshot, dark=view.dark)
        if view.distances:
            layers.draw_distances(canvas, snapshot, verdict, view, self._data.spoken)
        if view.acting:
            layers.draw_acting_points(canvas, snapshot, view, top)
        if view.motion:
            layers.draw_motion(canvas, snapshot, self._data.model.description.base.axes, top)
        layers.draw_pulls(canvas, snapshot)
        layers.draw_names(canvas, snapshot, self._data.parts.crown)
        if snapshot.door is not None:
            layers.draw_door(canvas, snapshot.door)
        for name, points in self._trails.items():
            if view.trails and len(points) > 1:
                canvas.lines(f"/trails/{name}", [points], _TRAILS[name], 2.5)

    def _draw_ghosts(self, snapshot: Snapshot) -> None:
        scene, parts, light = self._scene, self._data.parts, self._light
        for i in range(len(self._ghosts), len(snapshot.ghosts)):
            self._ghosts.append(RobotScene(scene, parts, i, light=light))
        for robot, ghost in zip_longest(self._ghosts, snapshot.ghosts):
            robot.root.visible = ghost is not None
            if ghost is not None:
                robot.update(ghost)
                robot.hide_links_near(self.robot)
