"""Folder "Edit this robot": changes of convex bodies, monitored pairs and ready posture."""

from html import escape
from itertools import combinations
from typing import Any

import numpy as np
import pinocchio as pin
import viser

from app.dashboard import phrases as words
from app.dashboard.markup import small
from app.dashboard.panels import Moment, Panel, Viewer
from app.dashboard.robots import new_folder
from app.dashboard.scene.canvas import add_mesh, to_viser
from app.dashboard.scene.colours import GHOSTS
from app.dashboard.scene.scene import node_of
from app.onboarding.write import BY_HAND, HandMade, save_by_hand
from app.robot import shapes
from app.robot.assets import is_own, robot_folder
from app.robot.description import RobotDescription
from app.robot.shapes import Shape, shape_mesh
from app.strict import Array

MOVE, SIZE = "move", "size"  # scene nodes of a body's gizmos, below the node of its frame
_NONE = "(none)"
_MIN_HALF = 0.002  # [m] smallest half extent of a body
_MAX_OFFSET = 5.0  # [m] largest coordinate of a body in its frame, and largest half extent
_DIGITS = 4  # [-] decimals of lengths [m] and angles [rad]


class EditPanel(Panel):
    """One viewer's changes to the shown robot, which are stored here until they are saved."""

    def __init__(self, viewer: Viewer) -> None:
        super().__init__(viewer)
        gui = self._gui
        self._robot = self._shared.model.description
        names = self._shared.model.body_names
        apart = combinations(enumerate(names), 2)  # neighbours in the chain form no pair
        self._pairs = {f"{a}-{b}" for (i, a), (k, b) in apart if k - i > 1}
        self._keys = {
            words.body(body.name, names) + (f" {i + 1}" if len(body.shapes) > 1 else ""): (body, i)
            for body in self._robot.bodies
            for i in range(len(body.shapes))
        }
        self._frames: dict[str, str] = {}
        self._drawn: dict[str, tuple[Shape, viser.MeshHandle]] = {}
        self._gizmos: tuple[str, tuple[viser.TransformControlsHandle, ...]] = (_NONE, ())
        self._sizing = False
        self._q_m = viewer.timeline.shown().q_m  # (n_m,) [rad or m] shown positions
        with gui.add_folder("Edit this robot", expand_by_default=False):
            self._text = gui.add_html("")
            hint = "The large gizmo moves and rotates the body, the small one resizes it."
            self._body = gui.add_dropdown("Body", (_NONE, *self._keys), hint=hint)
            with gui.add_folder("Monitored pairs", expand_by_default=False):
                self._watched = {}
                for pair in sorted(self._pairs):
                    box = gui.add_checkbox(words.spoken(pair, names), False)
                    self._watched[pair] = self.on_update(box, lambda _: self._switch_pairs())
            hint = "The shown posture. To change it, pull the arm or use “Joint sliders” (tab Lab)."
            ready, icon = "Use this posture as ready posture", viser.Icon.STRETCHING
            self.button(ready, lambda _: self._take_posture(), icon, hint=hint)
            own = self._robot.name if is_own(self._robot.name) else f"{self._robot.name}_by_hand"
            self._name = gui.add_text("Save as", own, hint="A letter, then letters, digits and _")
            self.button("Save and use", lambda _: self._save(), viser.Icon.DEVICE_FLOPPY)
            self.button("Discard", lambda _: self._discard(), viser.Icon.X, color="gray")
        self._discard()

    def update(self, moment: Moment) -> None:
        self._q_m = moment.shown.q_m
        self._draw()
        self._text.content = small(changes_html(self.changes, self._robot))

    def _discard(self) -> None:
        self.changes = HandMade({}, dict(self._robot.unwatched), None)
        for pair, box in self._watched.items():
            box.value = pair not in self._robot.unwatched

    def _shape(self, key: str) -> Shape:
        body, i = self._keys[key]
        return self.changes.shapes.get((body.name, i), body.shapes[i])

    def _set(self, key: str, shape: Shape) -> None:
        body, i = self._keys[key]
        shapes = {**self.changes.shapes, (body.name, i): shape}  # another thread reads the old one
        self.changes = self.changes._replace(shapes=shapes)

    def _switch_pairs(self) -> None:
        off = (pair for pair, box in self._watched.items() if not box.value)
        reasons = {pair: self._robot.unwatched.get(pair, BY_HAND) for pair in off}
        self.changes = self.changes._replace(unwatched=reasons)

    def _take_posture(self) -> None:
        posture = tuple(round(float(q), _DIGITS) for q in self._q_m)
        self.changes = self.changes._replace(ready=posture)

    def _save(self) -> None:
        name, own = self._name.value, self._robot.name
        there = robot_folder(own)
        again = name == own and is_own(own)
        save_by_hand(there, there if again else new_folder(name), self.changes)
        self._viewer.use_robot(name)

    def _draw(self) -> None:
        chosen, changed = self._body.value, self.changes.shapes
        edited = {key for key, (body, i) in self._keys.items() if (body.name, i) in changed}
        wanted = edited | ({chosen} - {_NONE})
        for key in self._drawn.keys() - wanted:
            self._drawn.pop(key)[1].remove()
        for key in wanted:
            shape = self._shape(key)
            if key not in self._drawn or self._drawn[key][0] != shape:
                node, mesh, T = f"{self._frame(key)}/mesh", shape_mesh(shape), shape.placement()
                look = {"color": GHOSTS[0], "opacity": 0.45, "flat_shading": True}
                scene = self._viewer.client.scene
                self._drawn[key] = shape, add_mesh(scene, node, mesh, T, **look)
        if self._gizmos[0] != chosen:
            for gizmo in self._gizmos[1]:
                gizmo.remove()
            self._gizmos = chosen, () if chosen == _NONE else self._take_hold(chosen)
        elif self._gizmos[1] and not self._sizing:
            self._gizmos[1][1].position = half_extents(self._shape(chosen))

    def _frame(self, key: str) -> str:
        """Name of the scene node at a body's frame, fixed to its joint; the first call adds it."""
        if key not in self._frames:
            model, (body, _) = self._shared.parts.kinematics.model, self._keys[key]
            frame = model.frames[model.getFrameId(body.frame)]
            position, wxyz = to_viser(frame.placement)
            node = f"{node_of(model, frame.parentJoint)}/edited_{key.replace(' ', '_')}"
            self._viewer.client.scene.add_frame(node, show_axes=False, position=position, wxyz=wxyz)
            self._frames[key] = node
        return self._frames[key]

    def _take_hold(self, key: str) -> tuple[viser.TransformControlsHandle, ...]:
        """Add the gizmos of a body: one moves and rotates it; one at its corner resizes it."""
        scene, shape = self._viewer.client.scene, self._shape(key)
        node, (position, wxyz) = f"{self._frame(key)}/{MOVE}", to_viser(shape.placement())
        free: Any = {"depth_test": False, "position": position, "wxyz": wxyz}
        whole = scene.add_transform_controls(node, scale=0.22, **free)
        fixed: Any = {"disable_rotations": True, "disable_sliders": True, "depth_test": False}
        fixed["position"] = half_extents(shape)
        corner = scene.add_transform_controls(f"{node}/{SIZE}", scale=0.09, **fixed)

        def move(event: Any) -> None:
            p = np.clip(event.target.position, -_MAX_OFFSET, _MAX_OFFSET)
            q = pin.Quaternion(*np.clip(event.target.wxyz, -1.0, 1.0))
            if q.norm() > 0.5:  # a gizmo sends unit quaternions
                self._set(key, placed(self._shape(key), pin.SE3(q.normalized().matrix(), p)))

        def resize(event: Any) -> None:
            self._sizing = event.phase != "end"
            half = np.clip(np.abs(event.target.position), _MIN_HALF, _MAX_OFFSET)
            self._set(key, resized(self._shape(key), half))

        for gizmo, act in ((whole, move), (corner, resize)):
            gizmo.on_update(self._notifier.guard(act))  # type: ignore[arg-type]
        return whole, corner


def half_extents(shape: Shape) -> Array:
    """Return the largest absolute coordinates (3,) [m] of a shape along its own axes."""
    return np.abs(shape_mesh(shape).bounds).max(axis=0)


def placed(shape: Shape, T: pin.SE3) -> Shape:
    """Return the shape at the pose T [m] in its body's frame."""
    if isinstance(shape, shapes.Capsule):
        return shape.model_copy(update=_ends(T, shape.length_m / 2))
    rpy = _three(pin.rpy.matrixToRpy(T.rotation))
    return shape.model_copy(update={"xyz_m": _three(T.translation), "rpy_rad": rpy})


def resized(shape: Shape, half: Array) -> Shape:
    """Return the shape, resized to `half_extents` of `half` (3,) [m] if its type permits them.

    The radius of a sphere becomes the entry of `half` with the largest relative change; for a
    cylinder or a capsule, only the entries for x and y are compared.
    """
    factor = half / half_extents(shape)
    across = factor if isinstance(shape, shapes.Sphere) else factor[:2]
    radius = round(float(half[np.abs(np.log(across)).argmax()]), _DIGITS)
    match shape:
        case shapes.Box():
            changed: dict[str, Any] = {"size_m": _three(2 * half)}
        case shapes.Superquadric():
            changed = {"semi_axes_m": _three(factor * shape.semi_axes_m)}
        case shapes.Hull():
            changed = {"vertices_m": tuple(_three(factor * v) for v in shape.vertices_m)}
        case shapes.ConvexMesh():
            changed = {"scale": _three(factor * shape.scale)}
        case shapes.Sphere():
            changed = {"radius_m": radius}
        case shapes.Cylinder():
            changed = {"radius_m": radius, "length_m": round(float(2 * half[2]), _DIGITS)}
        case shapes.Capsule():
            half_length = max(float(half[2]) - radius, 0.0)
            changed = {"radius_m": radius, **_ends(shape.placement(), half_length)}
    return shape.model_copy(update=changed)


def _ends(T: pin.SE3, half_length: float) -> dict[str, tuple[float, float, float]]:
    """Return both ends of a capsule's axis, from the capsule's pose T and half its length [m]."""
    along = np.array([0.0, 0.0, half_length])
    return {"start_m": _three(T.act(-along)), "end_m": _three(T.act(along))}


def _three(values: Array) -> tuple[float, float, float]:
    x, y, z = (round(float(value), _DIGITS) + 0.0 for value in values)
    return x, y, z


def changes_html(changes: HandMade, robot: RobotDescription) -> str:
    """Return a list of the unsaved changes to a robot, and a note about saved ones, as HTML."""
    chain = tuple(body.name for body in robot.bodies)
    texts = [f"{words.body(body, chain)}: {s.type}" for (body, _), s in changes.shapes.items()]
    for pair in sorted(changes.unwatched.keys() ^ robot.unwatched.keys()):
        state = f"{'not ' if pair in changes.unwatched else ''}monitored"
        texts.append(f"{words.spoken(pair, chain)}: {state}")
    if changes.ready:
        texts.append(f"ready posture {', '.join(f'{q:g}' for q in changes.ready)}")
    return (f"Not saved: <b>{escape('; '.join(texts))}</b>. " if texts else "") + (
        "Saved changes are in <code>robot.toml</code>, marked “set by hand”. If bodies or pairs "
        "change, the border is sampled again. <code>dbb check-robot</code> checks a saved robot."
    )
