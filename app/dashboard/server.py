"""The server: binds the address, runs the one thread that draws, and ends cleanly."""

from __future__ import annotations

import contextlib
import io
import logging
import socket
import threading
import time
from collections.abc import Mapping
from pathlib import Path

import viser
from viser import _messages

from app.border.cloud import Cloud
from app.dashboard.page import Page
from app.dashboard.panels.sweep import DEFAULT_FOLDER
from app.errors import LoopError, ServerError
from app.robot.model import RobotModel
from app.simulation.leading import Scenario
from app.simulation.loop import LoopHandle

logger = logging.getLogger(__name__)

FRAME = 1 / 30  # [s] between two pictures
TEXTS_EVERY = 3  # pictures between two renewals of panels, plots and labels: 10 Hz


class DashboardServer:
    """A page that shows a loop and sends it commands.

    Attributes:
        address: As to be typed into a browser.
        page: What is on it.
    """

    def __init__(self, viser_server: viser.ViserServer, page: Page, loop: LoopHandle) -> None:
        self.viser, self.page = viser_server, page
        self.address = f"http://{viser_server.get_host()}:{viser_server.get_port()}"
        self.error: BaseException | None = None
        """Why the drawing thread ended, if it did."""
        self._loop = loop
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._draw_until_stopped, name="dashboard")
        self._thread.daemon = True
        self._thread.start()

    def run_forever(self) -> None:
        """Serve until `stop` is called from another thread, or Ctrl-C.

        Raises:
            LoopError: On the way out, if the simulation or the drawing has ended with an error;
                until then the page stays and shows it.
        """
        with contextlib.suppress(KeyboardInterrupt):
            self._stopping.wait()
        self.stop()
        error = self._loop.error or self.error
        if error is not None:
            raise LoopError(f"the simulation ended: {type(error).__name__}: {error}") from error

    def stop(self) -> None:
        """End the drawing thread and close the page; the loop is not touched."""
        self._stopping.set()
        if self._thread is not threading.current_thread():
            self._thread.join(timeout=5.0)
        self.page.close()
        with _silence():
            self.viser.stop()

    def _draw_until_stopped(self) -> None:
        try:
            self._draw_frames()
        except (
            Exception
        ) as error:  # nobody joins this thread, so it has to say itself what went wrong
            self.error = error
            logger.exception("drawing ended")
            self.page.fail("Drawing has ended", error)

    def _draw_frames(self) -> None:
        frame, due, failed = 0, time.monotonic(), False
        while not self._stopping.wait(max(0.0, due - time.monotonic())):
            # After a hold-up go on from now: a burst of late pictures would only delay more.
            due = max(due + FRAME, time.monotonic())
            self.page.draw(texts=frame % TEXTS_EVERY == 0)
            frame += 1
            if self._loop.error is not None and not failed:
                failed = True
                logger.error("the simulation ended", exc_info=self._loop.error)
                self.page.fail("The simulation has ended", self._loop.error)


def serve_dashboard(
    loop: LoopHandle,
    model: RobotModel,
    clouds: Mapping[str, Cloud],
    *,
    host: str = "127.0.0.1",
    port: int = 8080,
    case: Scenario | None = None,
    sweeps: Path = DEFAULT_FOLDER,
) -> DashboardServer:
    """Open the page; it is drawn from the moment this returns.

    Args:
        loop: A started simulation loop.
        model: The robot that it simulates.
        clouds: P_i of every pair of L_m, by the pair's name.
        host: Address to listen at. viser has neither password nor encryption: only on a trusted
            network should it be more than this machine.
        port: Port to listen at; 0 takes a free one.
        case: A scenario that begins where the loop does, for a button that plays it.
        sweeps: Folder of the maps of sweeps, where new ones are written too.

    Raises:
        ServerError: The address cannot be bound.
        AssetError: A mesh of the robot is not there.
    """
    check_address(host, port)
    logging.getLogger("websockets").setLevel(logging.WARNING)  # every viewer's coming and going
    with _silence():
        server = viser.ViserServer(host=host, port=port, verbose=False)
    try:
        if port not in (0, server.get_port()):
            raise ServerError(f"port {port} was taken while the server started; try --port 0")
        _forbid_sharing(server)
        return DashboardServer(server, Page(server, loop, model, clouds, case, sweeps), loop)
    except BaseException:
        with _silence():
            server.stop()
        raise


def check_address(host: str, port: int) -> None:
    """Try to bind: viser waits for ever at a bad host and silently takes another port.

    Raises:
        ServerError: In one line, what is wrong and what to do.
    """
    if not 0 <= port <= 65535:  # getaddrinfo would take it modulo 65536
        raise ServerError(f"cannot listen at {host}:{port}: a port is between 0 and 65535")
    try:
        family, kind, *_, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    except OSError as error:
        raise ServerError(f"cannot listen at {host}:{port}: {error}") from None
    with socket.socket(family, kind) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(address)
        except OSError as error:
            hint = "; try another --port, or 0 for a free one"
            raise ServerError(f"cannot listen at {host}:{port}: {error}{hint}") from None


def _silence() -> contextlib.redirect_stdout[io.StringIO]:
    """Holds back what viser prints about itself: the address is the caller's to print."""
    return contextlib.redirect_stdout(io.StringIO())


def _forbid_sharing(server: viser.ViserServer) -> None:
    """Take away the handler by which any client could open a public tunnel to this machine."""
    for message in (_messages.ShareUrlRequest, _messages.ShareUrlDisconnect):
        server._websock_server.unregister_handler(message)
