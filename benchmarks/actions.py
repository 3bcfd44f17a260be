"""Random use of the dashboard in two viewers: `python -m benchmarks.actions [--actions 20000]`.

The program clicks, drags, scrolls and types at random in two pages of one `dbb serve`, and changes
the robot from time to time; a seed determines the actions. At each check the simulation is paused,
and in both pages the drawn end-effector must be at the gizmo. The results are the errors of the
pages, the exceptions of the server, the largest distance between end-effector and gizmo, and the
server's memory for each robot. The status is 1 after an error of a page, after an exception, and if
a distance is too large.
"""

from __future__ import annotations

import random
import re
import subprocess
import sys
import threading
import time
from collections import deque
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pinocchio as pin
import psutil
import tyro

from app.cli.common import print_result
from app.cli.options import Json
from app.dashboard.drag import GIZMO, SCALE
from app.dashboard.export.browser import chromium
from app.dashboard.scene.robot import LinkPoses
from app.dashboard.scene.scene import node_of
from app.robot.description import load_robot
from app.robot.model import RobotModel
from tests.browser import DashboardTab, wait_for

AGREES = 0.001  # [m] largest distance between the drawn end-effector and the gizmo
COVERED = "out/covered.png"  # picture of a page on which another robot could not be chosen
APART = "out/apart_{}_{}.png"  # pages of a pause in which end-effector and gizmo differ
PATIENCE = 60.0  # [s] time to wait until end-effector and gizmo agree
_END = 10.0  # [s] after which the simulation and the objects of a replaced robot are gone
_SIZES = (1280, 720), (820, 1180)  # [px] sizes of the two pages
_KEYS = (
    *"BFNRLH1234567?",
    *("Space", "Escape", "Tab", "Enter", "Home", "End", "PageUp", "PageDown"),
    *("ArrowLeft", "ArrowRight", "Shift+ArrowUp", "Shift+ArrowLeft", "Control+k"),
)
_TEXTS = ("0", "-3", "1e9", "nan", "", "abc", "0.2", "12,5", "1", "∞", "<b>")
_LEAVE = re.compile(
    r"^(Use this robot|Create|Save and use|Check the saved|Film|Load|Upload|Cancel)"
)
"""Buttons that are not pressed: they take minutes, need a file, or change the robot."""
_CONTROLS = """() => [...document.querySelectorAll(
  'button, [role=tab], [role=slider], [role=option], input, select, #dbb-strip')]
  .map((e) => [e, e.getBoundingClientRect()])
  .filter(([e, b]) => b.width > 2 && b.height > 2 && b.top >= 0 && b.bottom <= innerHeight
    && e.contains(document.elementFromPoint(b.left + b.width / 2, b.top + b.height / 2)))
  .map(([e, b]) => [(e.innerText || e.ariaLabel || e.value || '').trim().slice(0, 60),
    e.matches('input') && !e.readOnly && e.type !== 'checkbox',
    b.left + b.width * 0.5, b.top + b.height * 0.5])"""
_PAUSES = "() => document.querySelector('#dbb-row button')?.innerText"
"""Text of the button that pauses or continues the simulation."""
_PRESS = "() => document.querySelector('#dbb-row button').click()"  # works also under an overlay
_LEAVE_SETTINGS = (
    "() => document.querySelector('.tabler-icon-arrow-back')?.closest('button')?.click()"
)
"""Closes viser's settings, which cover the tabs."""
_AT = "([n, p]) => dbbTest.place(n, p)"


@dataclass(frozen=True)
class Actions:
    """Perform random actions in two viewers of one dashboard."""

    actions: int = 20_000
    """[-] number of actions of both viewers together."""
    robots: tuple[str, ...] = ("husky_ur5", "frankie", "husky_panda")
    """Robots that replace husky_panda one after the other, each for the same number of actions."""
    checks: int = 40
    """[-] number of pauses in which the end-effector and the gizmo are compared."""
    seed: int = 0
    """Seed of the actions."""
    json: Json = False


@dataclass
class _Server:
    """`dbb serve` in a separate process, and the output of this process."""

    lines: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        command = [sys.executable, "-m", "app", "serve", "--port", "0"]
        self.process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        threading.Thread(target=self._read, daemon=True).start()
        wait_for(lambda: self.address, 600.0, "the server's address")

    @property
    def address(self) -> str:
        """The address that the server has printed, or empty."""
        found = re.search(r"Dashboard at (\S+)", "".join(self.lines))
        return found.group(1) if found else ""

    @property
    def exceptions(self) -> int:
        """Number of exceptions that the server has printed."""
        return sum("Traceback" in line for line in self.lines)

    @property
    def megabytes(self) -> tuple[float, float]:
        """[MB] resident memory of the process, and of all its child processes."""
        parent = psutil.Process(self.process.pid)
        children = sum(p.memory_info().rss for p in parent.children(recursive=True))
        return parent.memory_info().rss / 1e6, children / 1e6

    def _read(self) -> None:
        assert self.process.stderr is not None
        self.lines.extend(self.process.stderr)


class _Run:
    """The pages, the actions and the results."""

    def __init__(self, browser: Any, server: _Server, args: Actions) -> None:
        self._server, self._args, self._random = server, args, random.Random(args.seed)
        self._tabs = [DashboardTab(browser, server.address, size) for size in _SIZES]
        self._robot, self._ee = "", ("", np.zeros(3))
        self._memory: list[tuple[str, tuple[float, float]]] = []
        self._off = 0.0
        self._failed: list[str] = []
        self._apart: list[str] = []
        self._last: deque[str] = deque(maxlen=30)
        self._use("husky_panda")

    def all(self) -> dict[str, Any]:
        """Perform all actions, and return the results."""
        args, began = self._args, time.monotonic()
        part = args.actions // (len(args.robots) + 1)
        changes = {part * (k + 1): name for k, name in enumerate(args.robots)}
        check = max(args.actions // args.checks, 1)
        for k in range(1, args.actions + 1):
            self._act(self._random.choice(self._tabs))
            if k in changes:
                self._change(changes[k])
            if k % check == 0:
                self._check(k)
        megabytes: dict[str, list[tuple[int, ...]]] = {}
        for robot, each in self._memory:
            megabytes.setdefault(robot, []).append(tuple(map(round, each)))
        return {
            "actions": args.actions,
            "seconds": round(time.monotonic() - began),
            "page_errors": [error for tab in self._tabs for error in tab.errors],
            "server_exceptions": self._server.exceptions,
            "server_says": self._server.lines[1:][-20:],
            "actions_that_failed": self._failed,
            "apart_after": self._apart,
            "largest_distance_of_end_effector_and_gizmo_mm": 1000.0 * self._off,
            "pauses": len(self._memory),
            "megabytes_of_server_and_children_by_robot": megabytes,
        }

    def _act(self, tab: DashboardTab) -> None:
        act = self._random.choices(
            (self._click, self._key, self._type, self._drag_scene, self._pull, self._scroll),
            (10, 4, 3, 3, 2, 2),
        )[0]
        self._last.append(f"{self._tabs.index(tab)} {act.__name__}")
        try:
            act(tab)
        except Exception as error:  # the control has possibly disappeared in the meantime
            if len(self._failed) < 20:
                self._failed.append(f"{act.__name__}: {str(error).splitlines()[0]}")

    def _controls(self, tab: DashboardTab) -> list[tuple[str, bool, float, float]]:
        found = tab.page.evaluate(_CONTROLS)
        return [tuple(each) for each in found if not _LEAVE.match(each[0])]

    def _click(self, tab: DashboardTab) -> None:
        if controls := self._controls(tab):
            name, _, x, y = self._random.choice(controls)
            self._last[-1] += f" {name}"
            tab.page.mouse.click(x, y)

    def _key(self, tab: DashboardTab) -> None:
        key = self._random.choice(_KEYS)
        self._last[-1] += f" {key}"
        tab.page.keyboard.press(key)

    def _type(self, tab: DashboardTab) -> None:
        if boxes := [each for each in self._controls(tab) if each[1]]:
            _, _, x, y = self._random.choice(boxes)
            tab.page.mouse.click(x, y, click_count=3)
            tab.page.keyboard.type(self._random.choice(_TEXTS))
            tab.page.keyboard.press("Enter")

    def _place(self, tab: DashboardTab) -> np.ndarray:
        left, top, right, bottom = tab.canvas_box()
        u, v = self._random.uniform(0.1, 0.9), self._random.uniform(0.1, 0.6)
        return np.array([left + u * (right - left), top + v * (bottom - top)])

    def _drag_scene(self, tab: DashboardTab) -> None:
        self._drag(tab, self._place(tab), self._place(tab))

    def _pull(self, tab: DashboardTab) -> None:
        """Drag a random arrow of the gizmo from its present place to a random place near it."""
        arrow = np.zeros(3)
        arrow[self._random.randrange(3)] = 0.8 * SCALE
        [at] = tab.pixels(GIZMO, arrow[None])
        self._drag(tab, at, at + np.array([self._random.gauss(0, 60) for _ in range(2)]))

    def _drag(self, tab: DashboardTab, a: np.ndarray, b: np.ndarray) -> None:
        mouse = tab.page.mouse
        mouse.move(*a)
        mouse.down()
        mouse.move(*((a + b) / 2))
        mouse.move(*b)
        mouse.up()

    def _scroll(self, tab: DashboardTab) -> None:
        width, height = _SIZES[self._tabs.index(tab)]
        x, y = self._random.uniform(0, width), self._random.uniform(0, height)
        tab.page.mouse.move(x, y)
        tab.page.mouse.wheel(0, self._random.choice((-300, -60, 60, 300)))

    def _change(self, robot: str) -> None:
        """Choose another robot in the first page, and wait until both pages show it.

        Then wait until the old simulation has ended, because a check can follow at once. If the
        robot cannot be chosen, for example because a random action has covered the button, reload
        the page and choose again; the results report this.
        """
        try:
            self._choose(robot)
        except Exception as error:
            self._failed.append(f"change to {robot}: {error}; the page was reloaded")
            print(self._failed[-1], file=sys.stderr, flush=True)
            self._tabs[0].page.screenshot(path=COVERED)
            self._tabs[0].page.reload()
            self._tabs[0].wait_for_scene()
            self._choose(robot)
        self._use(robot)
        for each in self._tabs:
            each.wait("n => dbbPage.ready() && dbbPage.has(n)", self._ee[0], 900.0)
            each.wait_for_scene()
        self._tabs[0].page.wait_for_timeout(1000 * _END)

    def _choose(self, robot: str) -> None:
        first = self._tabs[0]
        self._calm(first)
        first.open_tab("Robot")
        first.choose("Robot", robot)
        first.click("Use this robot")

    def _use(self, name: str) -> None:
        """Store a robot's name, and the end-effector's position in the frame of the last joint."""
        robot = RobotModel(load_robot(name))
        arm, poses = robot.description.arm, LinkPoses(robot)
        q_m = np.array(arm.ready_position)
        data = robot.pin.createData()
        pin.framesForwardKinematics(robot.pin, data, robot.configuration(np.zeros(3), q_m))
        p_ee = data.oMf[robot.ee_frame].translation
        last = poses.model.getJointId(arm.joints[-1])
        found = poses.update(q_m, np.zeros(len(robot.description.base.wheels)))[last]
        self._robot, self._ee = name, (node_of(poses.model, last), found.actInv(p_ee))

    def _calm(self, tab: DashboardTab) -> None:
        """Close all overlays and viser's settings, remove the focus, and go to the present."""
        for _ in range(3):
            tab.page.keyboard.press("Escape")
        tab.page.evaluate(_LEAVE_SETTINGS)
        tab.page.evaluate("() => document.activeElement?.blur()")
        tab.page.keyboard.press("n")

    def _check(self, count: int) -> None:
        """Pause the simulation, and compare end-effector and gizmo in both pages when they rest."""
        for tab in self._tabs:
            self._calm(tab)
        for tab in self._tabs:
            tab.wait_for_scene()
        paused = self._press("Pause")
        places = [self._settled(tab) for tab in self._tabs]
        offs = [float(np.linalg.norm(drawn - gizmo)) for drawn, gizmo in places]
        self._off = max(self._off, *offs)
        if max(offs) >= AGREES:
            at = "; ".join(f"end-effector {drawn}, gizmo {gizmo}" for drawn, gizmo in places)
            self._apart.append(f"{count} actions: {at}, after {', '.join(self._last)}")
            print(self._apart[-1], file=sys.stderr, flush=True)
            for k, tab in enumerate(self._tabs):
                tab.page.screenshot(path=APART.format(count, k))
        self._memory.append((self._robot, self._server.megabytes))
        text = f"{count} actions, {self._robot}: {1000 * max(offs):.2f} mm"
        server, children = self._memory[-1][1]
        print(f"{text}, {server:.0f} + {children:.0f} MB", file=sys.stderr, flush=True)
        if not paused:
            self._press("Continue")

    def _press(self, name: str) -> bool:
        """Press the pause button until its text is no longer `name`, or time is up.

        Returns:
            Whether the button had another text before.
        """
        page, deadline = self._tabs[0].page, time.monotonic() + PATIENCE
        page.wait_for_timeout(1000)  # the effect of the last action has arrived
        absent = page.evaluate(_PAUSES) != name
        while page.evaluate(_PAUSES) == name and time.monotonic() < deadline:
            page.evaluate(_PRESS)
            page.wait_for_timeout(2000)
        return absent

    def _settled(self, tab: DashboardTab) -> tuple[np.ndarray, np.ndarray]:
        """Wait until end-effector and gizmo agree, or time is up; return both positions (3,) [m].

        The drawn end-effector comes first. A page whose connection was closed reconnects; until
        then it has no scene.
        """
        deadline = time.monotonic() + PATIENCE
        node, point = self._ee
        while True:
            drawn = np.array(tab.page.evaluate(_AT, [node, point.tolist()]))
            gizmo = tab.position(GIZMO)
            if np.linalg.norm(drawn - gizmo) < AGREES or time.monotonic() > deadline:
                return drawn, gizmo
            tab.page.wait_for_timeout(200)


def main(args: Actions) -> None:
    """Perform the actions and print the results."""
    server = _Server()
    try:
        with chromium() as browser:
            result = _Run(browser, server, args).all()
    finally:
        server.process.terminate()
        server.process.wait(60.0)
    print_result(result, json=args.json)
    if result["page_errors"] or result["server_exceptions"] or result["apart_after"]:
        sys.exit(1)


if __name__ == "__main__":
    main(tyro.cli(Actions))
