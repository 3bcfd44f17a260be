"""A dashboard with a loop without physics, for tests with a browser or a raw client."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import NamedTuple

from app.border.dbb import Cloud
from app.dashboard.page import Page
from app.dashboard.robots import StartLoop
from app.dashboard.scene.robot import RobotParts
from app.dashboard.server import DashboardServer, serve_dashboard
from app.simulation.loop.commands import Compare, Pause, Reset, Speed
from tests.browser import DashboardTab, wait_for
from tests.fakes import ScriptedLoop, fake_clouds
from tests.robots import husky_panda


class Served(NamedTuple):
    """A running dashboard and the loop behind it."""

    server: DashboardServer
    loop: ScriptedLoop

    def page(self) -> Page:
        """The page of the newest viewer."""
        wait_for(lambda: self.server.pages, what="a viewer's page")
        return self.server.pages[max(self.server.pages)]

    def begin_anew(self) -> None:
        """Return to the first state, except for the parameters and the viewers' choices."""
        for command in (Compare(), Speed(1.0), Pause(False), Reset()):
            self.loop.send(command)
        self.loop.commands.clear()

    def pull_at_base(self, seconds: float, tab: DashboardTab | None = None) -> None:
        """Call the loop's `pull_at_base` after dashboard and tab have handled a reset.

        A page that handles the reset later leads a viewer of the past back to the present.
        """
        self.loop.send(Pause(True))
        self.loop.send(Reset())
        wait_for(lambda: self.server.shared.last <= 0.0, what="the reset")
        if tab is not None:
            tab.wait("() => dbb.seen().now === 0")
        self.loop.pull_at_base(seconds)


@contextmanager
def served_dashboard(
    loop: ScriptedLoop | None = None, port: int = 0, start_loop: StartLoop | None = None
) -> Iterator[Served]:
    """Serve in the `with` block; fail if the drawing thread has failed.

    Args:
        loop: The first loop behind the dashboard; by default a new `ScriptedLoop`.
        port: 0 chooses a free port.
        start_loop: Starts the loop of another robot.
    """
    loop = loop or ScriptedLoop(husky_panda())
    loop.start()
    try:
        server = serve_dashboard(
            loop, husky_panda(), clouds(), port=port, parts=parts(), start_loop=start_loop
        )
        try:
            yield Served(server, loop)
        finally:
            server.stop()
        assert server.error is None, "the drawing thread has failed"
    finally:
        loop.stop()


@cache
def parts() -> RobotParts:
    """The robot's meshes, read and decimated once."""
    return RobotParts(husky_panda())


@cache
def clouds() -> dict[str, Cloud]:
    """Coarse synthetic clouds, which are fast to draw."""
    return fake_clouds(husky_panda(), spacing=0.02)
