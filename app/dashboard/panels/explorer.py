"""Folder "Joint sliders": the controller's response to a posture while the simulation is paused."""

from functools import partial
from threading import RLock
from typing import Any

import numpy as np
import viser

from app.dashboard import phrases as words
from app.dashboard.explorer import CLOSE, Posture
from app.dashboard.markup import RIGHT, cell, row, small, table
from app.dashboard.panels import Moment, Panel, Viewer
from app.errors import TargetError
from app.robot.bases.kind import planar
from app.simulation.loop.commands import Pause, Reset
from app.simulation.trace.snapshot import Snapshot
from app.simulation.trace.words import millimetres
from app.strict import Array

FARTHEST = 5.0  # [m] largest base coordinate


class ExplorerPanel(Panel):
    """Sliders of base and arm; while they are in use, the page shows the posture that they set."""

    def __init__(self, viewer: Viewer) -> None:
        super().__init__(viewer)
        self.posture: Posture | None = None  # on the page; None while no slider is in use
        self._target: Array | None = None  # (3,) [m] new target of the end-effector
        self._error = 0.0  # [m] distance of the end-effector from the last target
        self._paused = False  # whether the pause has taken effect
        self._since = viewer.shared.loop.latest()  # newest snapshot when posing began
        self._lock = RLock()  # a callback can change the posture while the page is drawn
        model, turn = viewer.shared.model, float(np.degrees(1.0))
        self._scale = np.array([1.0 if unit == "m" else turn for unit in model.joint_units])
        with self._gui.add_folder("Joint sliders", expand_by_default=False):
            self._text = self._gui.add_html("")
            self._begin = self.button("Pause and pose the arm", self._enter, viser.Icon.STRETCHING)
            self._sliders = [
                self._slider("base x", -FARTHEST, FARTHEST, 0.01, "m"),
                self._slider("base y", -FARTHEST, FARTHEST, 0.01, "m"),
                self._slider("base heading", -180.0, 180.0, 0.5, "°"),
            ]
            for i, name in enumerate(model.description.arm.joints):
                low, high = np.array([model.q_lower[i], model.q_upper[i]]) * self._scale[i]
                unit = "m" if self._scale[i] == 1.0 else "°"
                step = 0.001 if unit == "m" else 0.1
                low, high = np.ceil(low / step) * step, np.floor(high / step) * step
                self._sliders.append(self._slider(name, float(low), float(high), step, unit))
            self._start = self.button("Start from this posture", self._go, viser.Icon.PLAYER_PLAY)
            self._leave = self.button("Discard the posture", lambda _: self._end(), color="gray")
        self._show(on=False)

    def shown(self, newest: Snapshot, shown: Snapshot) -> Snapshot:
        """Return the snapshot to draw: the response to the posture, or `shown` without a posture.

        The posture is discarded if the simulation continues or restarts, or if the past is shown.
        """
        if (posture := self.posture) is None:
            return shown
        self._paused = self._paused or newest.paused
        continued = not newest.follows(self._since) or (self._paused and not newest.paused)
        if continued or not self._viewer.timeline.live:
            cause = "the simulation runs again" if continued else "the page shows the past"
            text = f"The posture is discarded: {cause}."
            self._viewer.notifier.tell(self._viewer.client, "Joint sliders", text)
            self._end()
            return shown
        explorer = self._shared.explorer
        place, self._target = self._target, None
        if place is not None:
            before, (posture, error) = posture, explorer.reach(posture, place)
            with self._lock:
                if self.posture is not before:  # a slider has changed it, or posing has ended
                    return shown
                self.posture, self._error = posture, error
                self._set(posture)
        return explorer.respond(posture, newest)

    def update(self, moment: Moment) -> None:
        if self.posture is None:
            self._text.content = small(
                "Pause the simulation, then move joints, base and end-effector: the readings are "
                "the controller's response."
            )
            return
        shown, head = moment.shown, ("", "distance d", "activation β", "force f")
        forces = {each.name: float(np.linalg.norm(each.f)) for each in shown.acting}
        rows = [row(*(cell(name, RIGHT) for name in head))]
        for pair in shown.pairs:
            force = f"{forces[pair.name]:.0f} N" if pair.name in forces else "–"
            texts = (cell(x, RIGHT) for x in (millimetres(pair.d), f"{pair.beta:.2f}", force))
            rows.append(row(cell(self._shared.spoken[pair.name]), *texts))
        axes, error = self._shared.model.description.base.axes, self._error
        way = words.acceleration(*planar(axes, shown.base_acceleration))
        far = f"<br>The end-effector is {millimetres(error)} off its target."
        text = f"{table(rows)}base acceleration: {way}{far if error > CLOSE else ''}"
        self._text.content = small(text)

    def _slider(self, label: str, low: float, high: float, step: float, unit: str) -> Any:
        first = min(max(0.0, low), high)
        handle = self._gui.add_slider(f"{label} [{unit}]", low, high, step, first)
        return self.on_update(handle, lambda _: self._read())

    def _enter(self, _: Any) -> None:
        newest = self._shared.loop.latest()
        if newest.door is not None:
            reason = "the end-effector holds a door in this scenario"
            raise TargetError(f"{reason}; choose another scenario first")
        self._shared.loop.send(Pause(True))
        self._viewer.timeline.go_live()
        self._paused, self._since = False, newest
        self._error, posture = 0.0, Posture(np.array(newest.base_pose), np.array(newest.q_m))
        with self._lock:
            self._set(posture)
            self.posture, self._viewer.grip.reach = posture, partial(setattr, self, "_target")
            self._show(on=True)

    def _go(self, _: Any) -> None:
        if (posture := self.posture) is None:
            return
        x, y, phi = map(float, posture.base_pose)
        self._shared.loop.send(Reset(tuple(map(float, posture.q_m)), (x, y, phi)))
        self._shared.loop.send(Pause(False))
        self._end()

    def _end(self) -> None:
        with self._lock:
            self._viewer.grip.release()  # otherwise the rest of a drag would pull the robot
            self.posture = self._target = self._viewer.grip.reach = None
            self._show(on=False)

    def _read(self) -> None:
        with self._lock:
            if self.posture is None:
                return
            values = np.array([min(max(s.value, s.min), s.max) for s in self._sliders])
            base = np.append(values[:2], np.radians(values[2]))
            self.posture, self._error = Posture(base, values[3:] / self._scale), 0.0

    def _set(self, posture: Posture) -> None:
        x, y, phi = posture.base_pose
        phi = (phi + np.pi) % (2 * np.pi) - np.pi
        values = [x, y, np.degrees(phi), *(posture.q_m * self._scale)]
        for slider, value in zip(self._sliders, values, strict=True):
            slider.value = float(np.clip(round(float(value), 3), slider.min, slider.max))

    def _show(self, *, on: bool) -> None:
        self._begin.visible = not on
        for handle in (*self._sliders, self._start, self._leave):
            handle.visible = on
