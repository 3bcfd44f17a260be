"""Replay: a run as one HTML file that plays in any browser, without a server or a network."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from html import escape

from app.border.cloud import Cloud
from app.dashboard.export.offscreen import RecordedLoop, offscreen_scene
from app.robot.model import RobotModel
from app.simulation.trace.log import Log

RATE = 25.0  # [Hz] pictures of a second
_TEXTS_EVERY = 5  # pictures between two renewals of labels and trails


def replay_html(
    log: Log,
    model: RobotModel,
    clouds: Mapping[str, Cloud],
    *,
    layer: str = "score",
    view: str = "iso",
    dark: bool = True,
    on_progress: Callable[[float], None] = lambda _: None,
) -> str:
    """The page of a log: robot, border, lines, arrows and trails, and a bar to go to any time.

    Args:
        log: What is shown.
        model: The robot of the log.
        clouds: P_i of every pair of L_m, by the pair's name.
        layer: What the border is coloured by, one of `app.dashboard.export.offscreen.LAYERS`.
        view: Where it is looked at from at first, a key of `app.dashboard.scene.camera.PRESETS`.
        dark: A dark page, else a light one.
        on_progress: Called now and then with how many seconds of the log are done.

    Raises:
        AssetError: A mesh of the robot is not there.
    """
    begin, end = log.snapshots[0].t, log.snapshots[-1].t
    pictures = 1 + round((end - begin) * RATE)
    with offscreen_scene(
        RecordedLoop(log.snapshots), model, clouds, layer=layer, dark=dark
    ) as made:
        made.look(view, log.snapshots[0])
        made.draw(begin)
        recording = made.server.get_scene_serializer()
        for k in range(1, pictures):
            recording.insert_sleep(1.0 / RATE)
            last = k == pictures - 1
            made.draw(begin + k / RATE, texts=last or k % _TEXTS_EVERY == 0)
            if k % round(RATE) == 0:
                on_progress(k / RATE)
        recording.insert_sleep(1.0 / RATE)
        page = recording.as_html(dark_mode=dark)
    return _titled(page, f"{log.meta.scenario or 'replay'}, {log.snapshots[0].controller}")


def _titled(page: str, title: str) -> str:
    """The page with a title of its own in the browser's tab."""
    head, begin, rest = page.partition("<title>")
    _, end, tail = rest.partition("</title>")
    return f"{head}{begin}{escape(title)}{end}{tail}" if end else page
