"""Off-screen scene: recorded snapshots drawn without widgets, for pictures and replays."""

from __future__ import annotations

import contextlib
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence

import viser

from app.border.cloud import Cloud
from app.dashboard.scene.camera import PRESETS, placed, set_first_look
from app.dashboard.scene.scene import Scene, SceneData
from app.dashboard.scene.theme import set_theme
from app.dashboard.view import HIDDEN, View
from app.dashboard.viser_compat import close_server, open_server
from app.robot.model import RobotModel
from app.simulation.loop.commands import Command
from app.simulation.trace.snapshot import Snapshot


class RecordedLoop:
    """The interface of the simulation's loop over recorded snapshots.

    Attributes:
        error: Always None: nothing runs that could end.
        links: None: nobody can pull.
        snapshots: In order of time.
    """

    def __init__(self, snapshots: Sequence[Snapshot]) -> None:
        """Stand at the first of the snapshots, of which there is at least one."""
        self.error: BaseException | None = None
        self.links: tuple[str, ...] = ()
        self.snapshots = tuple(snapshots)
        self._times = [snapshot.t for snapshot in self.snapshots]
        self._at = 0

    def go_to(self, t: float) -> Snapshot:
        """Stand at the last snapshot that is not later than a time [s], or at the first."""
        self._at = max(bisect_right(self._times, t + 1e-9) - 1, 0)
        return self.latest()

    def send(self, command: Command) -> None:
        """Commands have no effect on what has been recorded."""

    def latest(self) -> Snapshot:
        """The snapshot at which it stands."""
        return self.snapshots[self._at]

    def history(self, after: float) -> list[Snapshot]:
        """Snapshots with t > `after` [s] up to the one at which it stands, oldest first."""
        return list(self.snapshots[bisect_right(self._times, after) : self._at + 1])


HOST = "127.0.0.1"
LAYERS = ("determinant", "reachability", "score", "none")
"""What a border may be coloured by; without a border, none."""


class OffscreenScene:
    """All layers of the dashboard's scene, drawn from recorded snapshots.

    Attributes:
        server: viser's, at a free port of this machine.
        view: What is to be seen; read at each drawing.
        scene: The layers.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        loop: RecordedLoop,
        model: RobotModel,
        clouds: Mapping[str, Cloud],
        *,
        layer: str,
        dark: bool,
    ) -> None:
        """Send what does not change.

        Args:
            server: Of this scene alone.
            loop: What is shown.
            model: The robot.
            clouds: P_i of every pair of L_m, by the pair's name.
            layer: One of `LAYERS`, of the border of the first pair of L_m.
            dark: A dark ground, else a light one.
        """
        self.server, self._loop = server, loop
        self._data = SceneData(loop, model, clouds)
        self.view = View.first(self._data.mobile, [])
        choose_layer(self.view, layer)
        self.view.dark = dark
        set_theme(server.gui, dark=dark)
        self.scene = Scene(server.scene, self._data, self.view)

    def look(self, preset: str, snapshot: Snapshot) -> None:
        """Where new viewers look from.

        Args:
            preset: A key of `app.dashboard.scene.camera.PRESETS`.
            snapshot: Where base and hand are.
        """
        extent = self._data.parts.extent
        set_first_look(self.server, *placed(PRESETS[preset], snapshot, extent))

    def draw(self, t: float, *, texts: bool = True) -> Snapshot:
        """Draw the snapshot at a time [s]; trails lead up to it.

        Args:
            t: [s] of the simulation.
            texts: Whether labels and trails are due too.
        """
        snapshot = self._loop.go_to(t)
        self._data.update()
        self.scene.select_border(snapshot)
        with self.server.atomic():
            self.scene.draw(snapshot, texts=texts)
        return snapshot


def choose_layer(view: View, layer: str) -> None:
    """Colour the borders that are drawn by a layer.

    Args:
        view: What is to be seen.
        layer: One of `LAYERS`.
    """
    for pair, quantity in view.borders.items():
        if quantity != HIDDEN:
            view.borders[pair] = HIDDEN if layer == "none" else layer


@contextlib.contextmanager
def own_server() -> Iterator[viser.ViserServer]:
    """A server at a free port of this machine, for this program alone, closed at the end."""
    server = open_server(HOST, 0)
    try:
        yield server
    finally:
        close_server(server)


@contextlib.contextmanager
def offscreen_scene(
    loop: RecordedLoop,
    model: RobotModel,
    clouds: Mapping[str, Cloud],
    *,
    layer: str,
    dark: bool,
) -> Iterator[OffscreenScene]:
    """A scene with a server of its own, closed at the end; see `OffscreenScene`.

    Raises:
        AssetError: A mesh of the robot is not there.
    """
    with own_server() as server:
        yield OffscreenScene(server, loop, model, clouds, layer=layer, dark=dark)


def address_of(server: viser.ViserServer) -> str:
    """As to be typed into a browser."""
    return f"http://{HOST}:{server.get_port()}"
