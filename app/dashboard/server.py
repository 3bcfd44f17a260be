"""Server of the dashboard: binds the address, runs the drawing thread, and shuts down."""

import contextlib
import logging
import socket
import threading
import time
from collections.abc import Mapping, Sequence

import viser

from app.border.dbb import Cloud
from app.dashboard.job import give_back
from app.dashboard.markup import banner, plain
from app.dashboard.notifications import Notifier
from app.dashboard.page import PATIENCE, Page
from app.dashboard.robots import RobotSwitch, StartLoop
from app.dashboard.scene.camera import PRESETS, placed, set_first_look
from app.dashboard.scene.colours import set_theme
from app.dashboard.scene.robot import RobotParts
from app.dashboard.shared import SharedState
from app.dashboard.viser_compat import Watchdog, close_server, open_server
from app.errors import DbbError, LoopError, ServerError
from app.onboarding.read.package import LARGEST_ARCHIVE
from app.robot.model import RobotModel
from app.simulation.loop.commands import Release
from app.simulation.loop.loop import LoopHandle
from app.simulation.loop.pacing import gc_frozen
from app.simulation.scenarios.leading import Scenario
from app.simulation.trace.snapshot import Snapshot

logger = logging.getLogger("app.dashboard")  # for all errors that viewers can cause
_PAGE_ENDED = "This page has stopped; reload it. The simulation and other pages continue"

UNTOUCHED = 20.0  # [s] time before a demonstration on a page that nobody has touched
REST = 3.0  # [s] pause between two demonstrations
FRAME = 1 / 30  # [s] period of drawing
TEXTS_EVERY = 0.2  # [s] shortest period of updates of panels, plots and labels
LARGEST_SHARE = 0.5  # [-] largest share of a core's time for drawing; the same for building pages


class DashboardServer:
    """Pages that show a simulation and send it commands, one page for each viewer."""

    def __init__(self, viser_server: viser.ViserServer, shared: SharedState) -> None:
        self.viser, self.shared = viser_server, shared
        host = viser_server.get_host()
        # Browsers of some systems do not open the address that stands for all addresses.
        host = {"0.0.0.0": "localhost", "::": "::1"}.get(host, host)
        host = f"[{host}]" if ":" in host else host  # IPv6
        self.address = f"http://{host}:{viser_server.get_port()}"
        self.pages: dict[int, Page] = {}  # by the numbers that viser assigns to the viewers
        self.pictures = 0  # number of frames so far
        self.error: BaseException | None = None  # exception that ended drawing, or None
        self._texts_due = self._newcomer_due = 0.0  # [s] of `time.monotonic`
        self._demonstration_due: float | None = None  # [s] of `time.monotonic`
        self._notifier = Notifier(viser_server)
        self._failure: tuple[str, BaseException] | None = None
        self._here: set[int] = set()  # viewers whom `_newcomer` has returned
        self._stopping = threading.Event()
        work = self._draw_until_stopped
        self._thread = threading.Thread(target=work, name="dashboard", daemon=True)
        viser_server.on_client_disconnect(self._part)
        self.watchdog = Watchdog(viser_server, self._silent)
        self._thread.start()  # last, because only `stop` ends it

    def run_forever(self) -> None:
        """Wait for `stop` or Ctrl-C; then raise `LoopError` if simulation or drawing has failed.

        After Ctrl-C, the caller must call `stop`.
        """
        with contextlib.suppress(KeyboardInterrupt):
            give_back()
            with gc_frozen():
                self._stopping.wait()
        for part, error in (("simulation", self.shared.loop.error), ("drawing", self.error)):
            if error is not None:
                raise LoopError(f"the {part} ended: {type(error).__name__}: {error}") from error

    def stop(self) -> None:
        """End drawing, pages, jobs, server, and the last simulation that a switch has started."""
        self._stopping.set()
        self._thread.join(timeout=5.0)
        for page in list(self.pages.values()):
            page.end()
        self.shared.close()
        close_server(self.viser)

    async def _part(self, client: viser.ClientHandle) -> None:
        if page := self.pages.get(client.client_id):
            page.end()

    def _newcomer(self) -> viser.ClientHandle | None:
        """Return a viewer whom no earlier call has returned, or None."""
        clients = self.viser.get_clients()
        first = sorted(clients.keys() - self._here)[:1]
        self._here = self._here & clients.keys() | {*first}
        return clients[first[0]] if first else None

    def _silent(self, number: int) -> None:
        """Release the point of a silent viewer if its last pull is over `PATIENCE` ago."""
        if page := self.pages.get(number):
            page.grip.release_if_still(PATIENCE)

    def _draw_until_stopped(self) -> None:
        due = time.monotonic()
        try:
            while not self._stopping.wait(max(0.0, due - time.monotonic())):
                self._open_and_close_pages()
                begin = time.thread_time()
                self._draw_picture()
                # With many viewers the frame rate drops, so that drawing does not use all the time.
                # After a delay that is not computing time, continue from now: a burst of late
                # frames would only add to the delay.
                due = max(due + FRAME, _rested(begin))
        except Exception as error:  # no caller gets it: show it to the viewers
            self.error = error
            logger.exception("drawing ended")
            self._fail("Drawing has stopped", error)
            while not self._stopping.wait(0.2):
                if client := self._newcomer():
                    client.gui.add_html(banner("error", "Drawing has stopped", plain(error)))

    def _draw_picture(self) -> None:
        """Draw a frame of each page; no local name may keep a replaced robot in memory."""
        self.shared.watch(bool(self.viser.get_clients()))
        # A switch of the robot removes widgets. In a slow browser, an update of a widget could
        # arrive after its removal and cause an error: so the last update is `TEXTS_EVERY` ago.
        if texts := time.monotonic() >= self._texts_due:
            self._switch_robot()
            self._texts_due = time.monotonic() + TEXTS_EVERY
        shared, pages = self.shared, [page for page in self.pages.values() if not page.closed]
        shared.update()
        self._demonstrate(pages, shared.loop.latest())
        for page in pages:
            try:
                if texts or not page.view.light or self.pictures % 2 == 0:  # light: half the rate
                    page.draw(texts=texts)
            except Exception as error:  # ends only this viewer's page
                logger.exception("a page has ended")
                page.close()
                page.fail(_PAGE_ENDED, error)
        self.pictures += 1
        if (error := shared.loop.error) is not None and self._failure is None:
            logger.error("the simulation ended", exc_info=error)
            self._fail("The simulation has stopped", error)

    def _demonstrate(self, pages: Sequence[Page], newest: Snapshot) -> None:
        """Start, repeat or end the demonstration for a single viewer who has not touched the page.

        With the controller dbb, it starts after `UNTOUCHED` seconds without a scenario, a pause or
        a comparison, and again `REST` seconds after each end. The first input, a second viewer or
        another controller ends it.
        """
        due, self._demonstration_due = self._demonstration_due, None
        if len(pages) != 1 or not pages[0].untouched or newest.controller != "dbb":
            for page in pages:
                page.guide.leave_demonstration()
            return
        guide, now = pages[0].guide, time.monotonic()
        repeats = guide.state == "demo"
        if newest.scenario or newest.paused or newest.busy or (newest.ghosts and not repeats):
            return
        due = due or now + (REST if repeats else UNTOUCHED)
        if now <= due:
            self._demonstration_due = due
            return
        with contextlib.suppress(DbbError):  # the robot cannot play the scenario
            guide.watch("demo")

    def _open_and_close_pages(self) -> None:
        """Build at most one page, because this is slow; end the pages of disconnected viewers."""
        begin = time.thread_time()
        if time.monotonic() >= self._newcomer_due and (client := self._newcomer()):
            self._build_page(client)
            self._newcomer_due = _rested(begin)
        for number in self.pages.keys() - self.viser.get_clients().keys():
            self.pages.pop(number).end()

    def _build_page(self, client: viser.ClientHandle) -> None:
        number, before = client.client_id, self.pages.get(client.client_id)
        try:
            if before is None:
                with client.atomic():
                    page = Page(client, self.shared, self._notifier)
            else:
                page = before.with_robot(self.shared)
        except Exception as error:  # ends only this viewer's page
            logger.exception("a page could not be built")
            client.scene.reset()
            client.gui.reset()
            self.shared.loop.send(Release(number))  # a part of the page can have pulled
            client.gui.add_html(banner("error", _PAGE_ENDED, plain(error)))
            if before is not None:
                self.pages.pop(number).end()
            return
        self.pages[number] = page
        if self._failure is not None:
            page.fail(*self._failure)

    def _switch_robot(self) -> None:
        switch = self.shared.robot_switch
        if (robot := switch.take()) is None:
            return
        try:
            shown = robot.loop, robot.model, robot.clouds, robot.parts
            self.shared, self._failure = SharedState(*shown, before=self.shared), None
            self.shared.tuning.move_to(robot.loop, robot.config, robot.model.description.config)
            for number in list(self.pages):
                self._build_page(self.pages[number].client)
        finally:
            switch.shown()  # also after an error: the switch's thread waits for this
        note = f"; {robot.note}" if robot.note else ""
        self._notifier.tell(None, "Robot", f"{robot.model.description.title} is in use{note}.")

    def _fail(self, title: str, error: BaseException) -> None:
        self._failure = (title, error)
        for page in self.pages.values():
            page.fail(title, error)


def serve_dashboard(
    loop: LoopHandle,
    model: RobotModel,
    clouds: Mapping[str, Cloud],
    *,
    host: str = "127.0.0.1",
    port: int = 8080,
    allowed: Sequence[str] = (),
    case: Scenario | None = None,
    parts: RobotParts | None = None,
    start_loop: StartLoop | None = None,
) -> DashboardServer:
    """Open the dashboard, and start to draw the simulation `loop`, which has published a snapshot.

    There is neither a password nor encryption: in a network that is not trusted, use an address
    that only this machine can reach. Port 0 selects a free port. Browsers can also use the names
    `host` and `allowed`. `clouds` has P_i of each pair of L_m, by the pair's name. A button plays
    the `case`, if any. `parts` are loaded if they are None. `start_loop` creates the simulation of
    another robot; if it is None, the robot cannot be changed.

    Raises `ServerError` if the address cannot be bound, and `AssetError` if the robot's URDF or the
    mesh of a convex body is missing.
    """
    check_address(host, port)
    switch = RobotSwitch(start_loop)
    switch.look()  # slow: before a viewer connects
    shared = SharedState(loop, model, clouds, parts, case=case, robot_switch=switch)
    server = open_server(host, port, LARGEST_ARCHIVE, allowed)
    try:
        if port not in (0, server.get_port()):
            raise ServerError(f"port {port} was taken while the server started; try --port 0")
        set_theme(server.gui, dark=True)  # until a viewer's own page is ready
        set_first_look(server, *placed(PRESETS["iso"], [loop.latest()], shared.parts.extent))
        return DashboardServer(server, shared)
    except BaseException:
        close_server(server)
        raise


def _rested(begin: float) -> float:
    """Return the next start of work [s, `monotonic`]; the last was `begin` [s, `thread_time`]."""
    work = time.thread_time() - begin
    return time.monotonic() + work * (1.0 / LARGEST_SHARE - 1.0)


def check_address(host: str, port: int) -> None:
    """Raise `ServerError` if viser cannot listen at an address: a bad host would make it hang."""
    failure = f"cannot listen at {host}:{port}"
    if not 0 <= port <= 65535:  # getaddrinfo would use the port modulo 65536
        raise ServerError(f"{failure}: a port is between 0 and 65535")
    try:
        family, kind, *_, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    except (OSError, UnicodeError) as error:  # UnicodeError: a label is empty or too long
        hint = "--host is a name or an address of this machine, without brackets and port"
        raise ServerError(f"{failure}: {error}; {hint}") from None
    with socket.socket(family, kind) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(address)
        except OSError as error:
            hint = "try another --port (0 for a free one) or another --host"
            raise ServerError(f"{failure}: {error}; {hint}") from None
