"""A scene of its own, without widgets and viewers, for pictures and replays."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping

import viser

from app.border.cloud import Cloud
from app.dashboard.export.recorded_loop import Film
from app.dashboard.guards.listening import close_server, open_server
from app.dashboard.panels.sweep import DEFAULT_FOLDER
from app.dashboard.scene.camera import PRESETS, placed, set_first_look
from app.dashboard.scene.scene import Scene
from app.dashboard.scene.theme import set_theme
from app.dashboard.shared import Shared
from app.dashboard.view import HIDDEN, View
from app.robot.model import RobotModel
from app.simulation.trace.snapshot import Snapshot

HOST = "127.0.0.1"
LAYERS = ("determinant", "reachability", "score", "none")
"""What a border may be coloured by; without a border, none."""


class Studio:
    """All layers of the dashboard's scene, drawn from a film.

    Attributes:
        server: viser's, at a free port of this machine.
        view: What is to be seen; read at each drawing.
        scene: The layers.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        film: Film,
        model: RobotModel,
        clouds: Mapping[str, Cloud],
        *,
        layer: str,
        dark: bool,
    ) -> None:
        """Send what does not change.

        Args:
            server: Of this studio alone.
            film: What is shown.
            model: The robot.
            clouds: P_i of every pair of L_m, by the pair's name.
            layer: One of `LAYERS`, of the border of the first pair of L_m.
            dark: A dark ground, else a light one.
        """
        self.server = server
        self._film = film
        self._shared = Shared(film, model, clouds, None, DEFAULT_FOLDER)
        self.view = View.first(self._shared.mobile, [])
        choose_layer(self.view, layer)
        self.view.dark = dark
        set_theme(server.gui, dark=dark)
        self.scene = Scene(server.scene, self._shared, self.view)

    def look(self, preset: str, snapshot: Snapshot) -> None:
        """Where whoever opens the page looks from.

        Args:
            preset: A key of `app.dashboard.scene.camera.PRESETS`.
            snapshot: Where base and hand are.
        """
        extent = self._shared.parts.extent
        set_first_look(self.server, *placed(PRESETS[preset], snapshot, extent))

    def draw(self, t: float, *, texts: bool = True) -> Snapshot:
        """Draw the film's snapshot at a time [s]; trails lead up to it.

        Args:
            t: [s] of the simulation.
            texts: Whether labels and trails are due too.
        """
        snapshot = self._film.go_to(t)
        self._shared.update()
        self.scene.select_border(snapshot)
        with self.server.atomic():
            self.scene.draw(snapshot, texts=texts)
        return snapshot

    def close(self) -> None:
        """End what the scene has started."""
        self._shared.close()


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
def studio(
    film: Film, model: RobotModel, clouds: Mapping[str, Cloud], *, layer: str, dark: bool
) -> Iterator[Studio]:
    """A studio with a server of its own, closed at the end.

    Args:
        film: What is shown.
        model: The robot.
        clouds: P_i of every pair of L_m, by the pair's name.
        layer: One of `LAYERS`.
        dark: A dark ground, else a light one.

    Raises:
        AssetError: A mesh of the robot is not there.
    """
    with own_server() as server:
        made = Studio(server, film, model, clouds, layer=layer, dark=dark)
        try:
            yield made
        finally:
            made.close()


def address_of(server: viser.ViserServer) -> str:
    """As to be typed into a browser."""
    return f"http://{HOST}:{server.get_port()}"
