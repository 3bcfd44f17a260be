"""Pictures without a display have the requested size and content and are reproducible."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import psutil
import pytest
from PIL import Image

from app.config import Config
from app.dashboard.export import Look
from app.dashboard.export.browser import VARIABLE, browser_path
from app.dashboard.export.offscreen import RecordedLoop, apply_look
from app.dashboard.export.screenshot import strip, take_pictures
from app.dashboard.view import HIDDEN, View
from app.errors import BrowserError
from app.simulation.case import RunSpec
from app.simulation.run import filmed
from app.simulation.scenarios import scenario_by_name
from tests.logs import random_snapshots

PROJECT = Path(__file__).parent.parent
LOOK = Look(width=200, height=150)


@pytest.fixture(scope="module")
def snapshots(robot, border_data):
    """Snapshots of a fast pull on the kinematic plant, which needs the least time."""
    scenario = scenario_by_name("guiding-front").changed(duration=1.5)
    run = RunSpec("husky_panda", scenario, Config(), physics="kinematic")
    return filmed(run, robot, border_data, [0.333, 1.0])


@pytest.fixture(scope="module")
def take(browser, snapshots, robot, border_data):
    """Return a function that takes pictures of the run, as arrays."""

    def pictures(look, times=(0.0, 1.0)):
        taken = take_pictures(browser, snapshots, times, robot, border_data.clouds, look)
        return [np.asarray(picture).astype(int) for picture in taken]

    return pictures


@pytest.fixture(scope="module")
def taken(take):
    """The first pictures of the scene, at the beginning and at the end."""
    return take(LOOK)


def share(a, b, least=8):
    """[-] share of the pixels in which a and b (H, W, 3) differ by more than `least`."""
    assert a.shape == b.shape
    return float((np.abs(a - b).max(axis=-1) > least).mean())


def test_run_is_recorded_up_to_the_last_requested_time(snapshots):
    times = [s.t for s in snapshots]
    assert times[-1] == pytest.approx(1.0, abs=1e-9)
    assert min(abs(t - 0.333) for t in times) < 1e-9
    assert len(times) == 51 + 1


def test_recorded_loop_shows_the_snapshots_up_to_a_time():
    rows = random_snapshots(1, 40)
    film = RecordedLoop(rows)
    for k in (39, 0, 17):
        assert film.go_to(rows[k].t) is rows[k]
        assert film.latest() is rows[k]
        assert film.history(-1.0) == rows[: k + 1]
        assert film.history(rows[k // 2].t) == rows[k // 2 + 1 : k + 1]
    between = (rows[4].t + rows[5].t) / 2
    assert film.go_to(between) is rows[4]
    assert film.go_to(-5.0) is rows[0]


def test_strip_shows_pictures_side_by_side_with_their_times():
    pictures = [Image.new("RGB", (300, 200), colour) for colour in ("red", "green", "blue")]
    whole = strip(pictures, [0.0, 1.25, 8.0], dark=True)
    assert whole.size == (900, 200)
    pixels = np.asarray(whole).astype(int)
    for k, picture in enumerate(pictures):
        part, plain = pixels[:, 300 * k : 300 * (k + 1)], np.asarray(picture).astype(int)
        assert share(part[40:, 1:], plain[40:, 1:]) == 0.0
        assert 0.0 < share(part[:40], plain[:40]) < 0.3
        assert share(part[:40, 200:], plain[:40, 200:]) == 0.0


def test_missing_browser_is_reported_with_its_installation(monkeypatch, tmp_path):
    monkeypatch.setenv(VARIABLE, str(tmp_path / "none"))
    with pytest.raises(BrowserError, match="does not exist"):
        browser_path("")
    monkeypatch.delenv(VARIABLE)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(sys, "platform", "linux")
    with pytest.raises(BrowserError, match="playwright install chromium"):
        browser_path(str(tmp_path / "none"))
    (tmp_path / "chromium").touch(mode=0o755)
    assert browser_path("") == str(tmp_path / "chromium")


@pytest.mark.browser
def test_picture_has_the_requested_size_and_is_reproducible(take, taken):
    """Pictures of several times show the motion from one viewpoint."""
    for picture, again in zip(taken, take(LOOK), strict=True):
        assert picture.shape == (150, 200, 3)
        assert share(picture, again, least=0) <= 0.005
    assert 0.005 < share(*taken) < 0.5


@pytest.mark.browser
def test_picture_shows_only_the_scene(taken):
    """The floor fades towards the upper edge, so the background there has one colour."""
    edge = taken[1][:10]
    assert np.ptp(edge.reshape(-1, 3), axis=0).max() <= 2


@pytest.mark.browser
@pytest.mark.parametrize(
    ("change", "least"),
    [({"layer": "none"}, 0.03), ({"layer": "reachability", "light": True}, 0.5)],
    ids=["no-layer", "layer-light"],
)
def test_each_option_changes_the_picture(take, taken, change, least):
    [picture] = take(replace(LOOK, **change), (1.0,))
    assert share(taken[1], picture) > least


def test_layer_colours_the_border_of_the_default_or_the_named_pair():
    for layer, pair, wanted in (
        ("reachability", "", ["reachability", HIDDEN]),
        ("reachability", "lm-l3", [HIDDEN, "reachability"]),
        ("none", "", [HIDDEN, HIDDEN]),
    ):
        view = View.first(["lm-lEE", "lm-l3"], [])
        apply_look(view, Look(layer=layer, pair=pair))
        assert [*view.borders.values()] == wanted
        assert view.slice == (layer != "none")


@pytest.mark.browser
def test_picture_of_the_page_shows_panels_and_is_reproducible(take):
    """A picture of another time is taken between the two."""
    a, _, b = take(Look(width=1000, height=420, page=True), (1.0, 0.0, 1.0))
    assert a.shape == (420, 1000, 3)
    assert share(a, b, least=0) <= 0.005
    for panel in (a[:, :300], a[:, -300:]):
        assert (panel.max(axis=-1) > 120).mean() > 0.01, "text"
    scene = a[:, 340:660]
    assert (scene.min(axis=-1) > 225).mean() > 0.006, "a white arm, which mirrors its surroundings"


@pytest.mark.browser
def test_ctrl_c_ends_the_browser_too(tmp_path):
    """The signal goes to the process group, as from a terminal, after the browser has started."""
    out = tmp_path / "a.png"
    process = subprocess.Popen(
        [sys.executable, "-m", "app", "screenshot", "tracking", "--at", "29", "--out", str(out)],
        cwd=PROJECT,
        start_new_session=True,
        stderr=subprocess.PIPE,
        text=True,
    )
    children: list[psutil.Process] = []
    try:
        deadline = time.monotonic() + 120
        while not any("--headless" in " ".join(_line(child)) for child in children):
            assert process.poll() is None
            assert time.monotonic() < deadline, "no browser was started"
            children = psutil.Process(process.pid).children(recursive=True)
            time.sleep(0.2)
        time.sleep(0.5)
        children = psutil.Process(process.pid).children(recursive=True)
        os.killpg(process.pid, signal.SIGINT)
        assert process.wait(timeout=60) == 130
        _, alive = psutil.wait_procs(children, timeout=20)
        assert alive == []
        assert not out.exists()
        assert process.stderr is not None
        assert process.stderr.read().strip().splitlines() == ["dbb: interrupted"]
    finally:
        for child in children:
            if child.is_running():
                child.kill()
        process.kill()


def _line(process: psutil.Process) -> list[str]:
    try:
        return process.cmdline()
    except psutil.Error:
        return []


_KILLED = """
import os, sys, tempfile
from contextlib import suppress
from pathlib import Path
import psutil
from app.dashboard.export.browser import chromium
from app.errors import BrowserError
try:
    with chromium() as browser:
        print(*Path(tempfile.gettempdir()).rglob("playwright_chromium*"))
        for process in psutil.Process().children(recursive=True):
            with suppress(psutil.Error):
                if sys.argv[1] in process.cmdline():
                    process.kill()
        browser.new_context()
except BrowserError:
    print("reported")
"""


@pytest.mark.browser
@pytest.mark.parametrize("word", ["--headless", "run-driver"])
def test_killed_browser_is_reported_and_its_temporary_files_are_removed(word: str) -> None:
    """The browser or playwright's driver is killed.

    The test runs in a separate process, because the browser of other tests must survive.
    """
    with tempfile.TemporaryDirectory() as short:  # the path of a browser's socket has a limit
        found = subprocess.run(
            [sys.executable, "-c", _KILLED, word],
            cwd=PROJECT,
            env={**os.environ, "TMPDIR": short},
            capture_output=True,
            text=True,
            timeout=120,
        )
        *folders, last = found.stdout.split()
        assert (len(folders), last) == (1, "reported"), found.stderr
        assert list(Path(short).iterdir()) == []
