"""A viewer of the dashboard in its own process: `python -m benchmarks.client KIND ADDRESS SECONDS`.

KIND is websocket, browser or drag (a browser that drags the end-effector). The viewer prints
`ready` when it is connected, and a JSON object with its counts at the end.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import numpy as np

from app.dashboard.drag import GIZMO, SCALE
from tests.browser import DashboardTab, chromium
from tests.raw_client import RawClient

AXIS = 0  # number of the gizmo's arrow along x
NEAR, FAR = 0.55, 0.90  # [m] x of the end-effector from the base's centre; the front is at 0.5 m
SWEEP = 4.0  # [s] duration of a sweep from FAR to NEAR and back
SWEEPS = 3  # [-] number of sweeps between two restarts
FIRST = 2.0  # [s] time in which a viewer receives the whole scene
MOVE = 0.05  # [s] time between two moves of the mouse
SILENCE = 0.2  # [s] length above which a silence of the server is reported


def browse(address: str, seconds: float, *, drag: bool) -> dict[str, Any]:
    """Show the page in headless Chromium; with `drag`, drag the end-effector repeatedly."""
    with chromium() as browser:
        tab = DashboardTab(browser, address, dpr=1.0)
        tab.rest()
        begin_frame = _frame(tab)
        print("ready", flush=True)
        begin = time.monotonic()
        end, sweeps = begin + seconds, 0
        while time.monotonic() < end:
            if drag:
                sweeps += _sweep(tab, end)
            else:
                tab.page.wait_for_timeout(200)  # [ms]
        frames = _frame(tab) - begin_frame
        return {
            "sweeps": sweeps,
            "page_frames_per_s": frames / (time.monotonic() - begin),
            "page_errors": tab.errors,
        }


def _sweep(tab: DashboardTab, end: float) -> int:
    """Drag the end-effector to the base and back until `SWEEPS` sweeps are done or time is `end`.

    Then release it and press Restart. If the robot is not visible yet, only press Restart. Returns
    the number of complete sweeps.
    """
    try:
        arrow, start = tab.arrow(GIZMO, AXIS, SCALE), tab.position(GIZMO)
    except LookupError:  # on a busy machine the robot is not visible yet
        _restart(tab)
        return 0
    tab.page.mouse.move(*tab.pixels(GIZMO, arrow[None])[0])
    tab.render(1)  # the gizmo reacts only after it has registered the pointer
    tab.page.mouse.down()
    begin, sweeps = time.monotonic(), 0.0
    while sweeps < SWEEPS and time.monotonic() < end:
        sweeps = (time.monotonic() - begin) / SWEEP
        share = 0.5 + 0.5 * np.cos(2.0 * np.pi * sweeps)
        x_base = tab.position("/robot")[0]
        target = np.array([x_base + NEAR + share * (FAR - NEAR), *start[1:]])
        tab.page.mouse.move(*tab.pixel("", tuple((target + arrow).tolist())))
        tab.page.wait_for_timeout(1000.0 * MOVE)
    tab.page.mouse.up()
    _restart(tab)
    return int(sweeps)


def _restart(tab: DashboardTab) -> None:
    tab.page.get_by_role("button", name="Restart").click()
    tab.page.wait_for_timeout(300)  # [ms] until the gizmo is at the end-effector again


def listen(address: str, seconds: float) -> dict[str, Any]:
    """Receive all messages as a browser does, and draw nothing.

    `silences_s` of the result has the start, by `time.monotonic`, and the length of each silence
    of the server that is longer than `SILENCE`.
    """
    with RawClient(address) as client:
        print("ready", flush=True)
        time.sleep(FIRST)
        first = known = client.received  # includes meshes and borders
        begin = since = time.monotonic()
        silences: list[tuple[float, float]] = []
        while time.monotonic() - begin < seconds - FIRST:
            time.sleep(MOVE)
            if client.received > known:
                silences.append((since, time.monotonic() - since))
                known, since = client.received, time.monotonic()
        silences.append((since, time.monotonic() - since))
    return {
        "first_megabytes": first / 1e6,
        "megabytes_per_s": (known - first) / max(seconds - FIRST, 1e-3) / 1e6,
        "silences_s": [silence for silence in silences if silence[1] > SILENCE],
    }


def _frame(tab: DashboardTab) -> int:
    return tab.page.evaluate("() => window.__viserTestpoints.rendererInfo.render.frame")


if __name__ == "__main__":
    kind, server, duration = sys.argv[1:4]
    if kind == "websocket":
        done = listen(server, float(duration))
    else:
        done = browse(server, float(duration), drag=kind == "drag")
    print(json.dumps(done))
