"""Drawing speed of the page without a GPU: `python -m benchmarks.page`.

A headless browser with software rendering shows the page of `dbb serve`; the page detects such
rendering and reduces its detail. The results are the rate of pictures, the delay of a drag, the
rate of sent bytes, and the longest time for which the page is blocked, also with the tab "Plots".
If other programs load the machine, compare two versions of the code by alternating runs.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from statistics import median
from typing import Any

import numpy as np
import psutil
import tyro
from websockets.asyncio.server import ServerConnection

from app.cli.common import load_robot_and_border, print_result
from app.cli.options import Json
from app.config import Config
from app.dashboard.drag import GIZMO, SCALE
from app.dashboard.export import browser as browsers
from app.dashboard.server import serve_dashboard
from app.simulation.loop.commands import Pause, Play, Pull
from app.simulation.loop.process_loop import ProcessLoop
from app.simulation.scenarios import scenario_by_name
from app.simulation.scenarios.start import find_start
from app.simulation.session import Session
from tests.browser import DashboardTab, chromium

AXIS = 2  # number of the gizmo's arrow upwards, which no panel covers
STEP = 0.10  # [m] height of a jump of the mouse
REST = 1.5  # [s] pause after each jump
JUMPS = 8  # [-] number of jumps
SIZE, LARGE = (1280, 720), (1600, 900)  # [px] sizes of the two pages
SETTLED = 6.0  # [s] time in which a page has loaded everything
_HELPERS = """
(() => {
  const watch = { endEffector: [], gizmo: [], stall: 0 };
  let before = performance.now(), moved = null;
  const { viewer, node, canvas } = window.dbbPage;
  const frame = () => window.__viserTestpoints?.rendererInfo?.render?.frame ?? 0;
  const height = (name) => {
    const object = node(name);
    object.updateWorldMatrix(true, false);
    return object.matrixWorld.elements[13];
  };
  const drawn = () => {
    const gl = canvas().getContext("webgl2");
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
    return performance.now();
  };
  window.addEventListener("pointermove", (event) => {
    if (!watch.jumps) return;
    const last = [watch.gizmoNode, watch.endEffectorNode].map(height);
    moved = { at: event.timeStamp, frame: frame(), last, gizmo: false };
  }, true);
  const look = () => {
    const now = performance.now();
    watch.stall = Math.max(watch.stall, now - before);
    before = now;
    if (moved && frame() > moved.frame) {
      if (!moved.gizmo && Math.abs(height(watch.gizmoNode) - moved.last[0]) > 0.03) {
        moved.gizmo = true;
        watch.gizmo.push(drawn() - moved.at);
      }
      if (moved.gizmo && Math.abs(height(watch.endEffectorNode) - moved.last[1]) > 0.003) {
        watch.endEffector.push(drawn() - moved.at);
        moved = null;
      }
    }
    requestAnimationFrame(look);
  };
  requestAnimationFrame(look);
  window.dbbWatch = watch;
})();
"""


@dataclass(frozen=True)
class Page:
    """Measure a page that the browser draws in software."""

    seconds: float = 10.0
    """[s] duration of each part."""
    swiftshader: bool = False
    """Draw with Chromium's own software renderer, which is two to three times slower than Mesa, the
    default."""
    json: Json = False


def main(args: Page) -> None:
    """Measure and print."""
    if args.swiftshader:
        browsers._EGL = browsers._SWIFTSHADER
    model, data = load_robot_and_border("husky_panda")
    config, scenario = Config(), scenario_by_name("guiding-front")
    q_start = find_start(model, data.pairs, config.border.d_b, scenario.start)
    loop = ProcessLoop(partial(Session, model, data, config), q_start)
    loop.start()
    try:
        server = serve_dashboard(loop, model, data.clouds, port=0)
        try:
            with chromium() as browser:
                result = _Measurement(browser, server.address, loop, args.seconds).all()
        finally:
            server.stop()
    finally:
        loop.stop()
    print_result(result, json=args.json)


class _Measurement:
    """Measure the pages one after the other."""

    def __init__(self, browser: Any, address: str, loop: ProcessLoop, seconds: float) -> None:
        self._browser, self._address = browser, address
        self._loop, self._seconds = loop, seconds
        self._sent = self._heard = 0
        self._count()

    def all(self) -> dict[str, Any]:
        """Measure everything, and return the results."""
        result: dict[str, Any] = {"cores": os.cpu_count(), "load_before": os.getloadavg()[0]}
        tab = self._open(SIZE)
        time.sleep(SETTLED)
        result |= {"first_megabytes": self._sent / 1e6}
        result |= {f"idle_{k}": v for k, v in self._over(tab, lambda: None).items()}
        result["picture_ms"] = self._picture(tab)
        self._loop.send(Play(scenario_by_name("guiding-front")))
        time.sleep(1.0)
        result |= {f"playing_{k}": v for k, v in self._over(tab, lambda: None).items()}
        result |= self._drag(tab)
        tab.close()
        tab = self._open(LARGE)
        tab.open_tab("Plots")
        time.sleep(SETTLED)
        self._loop.send(Play(scenario_by_name("guiding-front")))
        result |= {f"plots_{k}": v for k, v in self._over(tab, lambda: None).items()}
        tab.close()
        return result | {"page_errors": tab.errors}

    def _open(self, size: tuple[int, int]) -> DashboardTab:
        tab = DashboardTab(self._browser, self._address, size, dpr=None, draws=True, honest=True)
        tab.page.evaluate(_HELPERS)
        return tab

    def _over(self, tab: DashboardTab, act: Callable[[], None]) -> dict[str, float]:
        """Rates of pictures, bytes and pulls, and longest stall, while an action is repeated."""
        tab.page.evaluate("() => (dbbWatch.stall = 0)")
        begin, sent, heard, frame = time.monotonic(), self._sent, self._heard, _frame(tab)
        work = _work()
        while time.monotonic() < begin + self._seconds:
            act()
            tab.page.wait_for_timeout(50)  # [ms]
        frames, span = _frame(tab) - frame, time.monotonic() - begin
        return {
            "pictures_per_s": frames / span,
            "core_ms_per_picture": 1e3 * (_work() - work) / max(frames, 1),
            "kB_per_s": (self._sent - sent) / span / 1e3,
            "heard_per_s": (self._heard - heard) / span,
            "longest_stall_ms": tab.page.evaluate("() => dbbWatch.stall"),
        }

    def _picture(self, tab: DashboardTab) -> float:
        """[ms] duration of one complete picture while the simulation is paused."""
        self._loop.send(Pause(True))
        time.sleep(1.0)
        script = """async () => {
          const begin = performance.now();
          await dbbPage.render(1);
          return performance.now() - begin;
        }"""
        times = [tab.page.evaluate(script) for _ in range(7)]
        self._loop.send(Pause(False))
        return float(median(times))

    def _drag(self, tab: DashboardTab) -> dict[str, Any]:
        """Measure the delays after jumps of the mouse, then the rates of a continuous drag."""
        tab.page.evaluate(
            "([g, e]) => Object.assign(dbbWatch, "
            "{ gizmoNode: g, endEffectorNode: e, jumps: true })",
            [GIZMO, "/robot/panda_joint7"],
        )
        arrow = tab.arrow(GIZMO, AXIS, SCALE)
        start = tab.position(GIZMO)
        up = np.array([0.0, 0.0, 1.0])

        def to(height: float) -> None:
            tab.page.mouse.move(*tab.pixel("", tuple((start + arrow + height * up).tolist())))

        to(0.0)
        tab.render(1)
        tab.page.mouse.down()
        for i in range(JUMPS):
            to(STEP if i % 2 == 0 else 0.0)
            tab.page.wait_for_timeout(1000 * REST)
        found = tab.page.evaluate(
            "() => ({ gizmo: dbbWatch.gizmo, endEffector: dbbWatch.endEffector })"
        )
        tab.page.evaluate("() => (dbbWatch.jumps = false)")
        begin = time.monotonic()
        dragged = self._over(tab, lambda: to(STEP * np.sin(3.0 * (time.monotonic() - begin))))
        tab.page.mouse.up()
        return {
            "gizmo_follows_ms": median(found["gizmo"]) if found["gizmo"] else None,
            "hand_follows_ms": median(found["endEffector"]) if found["endEffector"] else None,
            "jumps_followed": len(found["endEffector"]),
            **{f"dragging_{key}": value for key, value in dragged.items()},
        }

    def _count(self) -> None:
        """Count all sent bytes and all received pulls."""
        send, pull = ServerConnection.send, self._loop.send

        async def sending(connection: ServerConnection, message: Any, *more: Any) -> None:
            self._sent += len(message)
            await send(connection, message, *more)

        def hearing(command: Any) -> None:
            self._heard += isinstance(command, Pull)
            pull(command)

        ServerConnection.send = sending  # type: ignore[method-assign]
        self._loop.send = hearing  # type: ignore[method-assign]


def _work() -> float:
    """[s] processor time of the browser's processes, on all cores."""
    browsers = [p for p in psutil.Process().children(recursive=True) if "chrom" in p.name()]
    return sum(sum(process.cpu_times()[:2]) for process in browsers)


def _frame(tab: DashboardTab) -> int:
    return tab.page.evaluate("() => window.__viserTestpoints.rendererInfo.render.frame")


if __name__ == "__main__":
    main(tyro.cli(Page))
