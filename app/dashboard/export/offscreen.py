"""Off-screen scene: recorded snapshots drawn without widgets, for pictures, films and replays."""

from __future__ import annotations

import base64
import contextlib
import io
import itertools
import re
import subprocess
import tempfile
from bisect import bisect_right
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
import viser
from PIL import Image, ImageDraw, ImageFont

from app.border.dbb import Cloud
from app.dashboard.export import Layer, Look
from app.dashboard.export.browser import chromium, new_context
from app.dashboard.job import loaded
from app.dashboard.scene import colours
from app.dashboard.scene.camera import PRESETS, Window, first_view, lens_of, placed, set_first_look
from app.dashboard.scene.canvas import Lens, in_world
from app.dashboard.scene.colours import Rgb, css, set_theme
from app.dashboard.scene.layers import standings
from app.dashboard.scene.scene import Scene
from app.dashboard.shared import SharedState
from app.dashboard.verdict import COLOURS
from app.dashboard.view import HIDDEN, View
from app.dashboard.viser_compat import close_server, open_server
from app.errors import OutputError
from app.jobs.process import Report
from app.jobs.progress import OnProgress
from app.robot.model import RobotModel
from app.simulation.loop.commands import Command
from app.simulation.loop.loop import LoopHandle
from app.simulation.trace.metrics import metrics, verdict
from app.simulation.trace.snapshot import GhostReading, Snapshot
from app.simulation.trace.trace import Stored, Trace
from app.simulation.trace.words import METHOD_WORDS, millimetres
from app.system import whole_file, write_whole

if TYPE_CHECKING:
    import playwright.sync_api as web

HOST = "127.0.0.1"
BARRIER = "/sent"  # scene node whose x coordinate is the last number of `send_barrier`
ONLY_SCENE = "body * { visibility: hidden !important; } canvas { visibility: visible !important; }"
TIMEOUT = 60.0  # [s] timeout of a page or a picture
RATE = 25.0  # [Hz] frame rate of a replay, and of a film that a viewer of the page requests
_MEANINGS: dict[Layer, str] = {  # meaning of a border's colours
    "score": "yellow: high score, purple: low score; avoidance turns yellow parts towards the arm",
    "determinant": "yellow: the base moves the point well, purple: less well",
    "reachability": "yellow: the arm reaches the point well, purple: less well",
    "none": "",
}
INK: dict[bool, Rgb] = {True: (240, 240, 245), False: (25, 30, 38)}
"""Text colour on a dark and on a light background."""
_HEIGHT, _MIN_HEIGHT = 0.04, 12  # [-] height of a line, relative to the picture; [px] least height
_YUV = ["-pix_fmt", "yuv420p"]
_WEB = ["-cpu-used", "5", "-row-mt", "1", "-deadline", "good", "-b:v", "0", "-crf", "32", *_YUV]
_X264 = ["-crf", "20", *_YUV, "-movflags", "+faststart"]
_PALETTE = "split[a][b];[a]palettegen[p];[b][p]paletteuse=dither=bayer"
CODECS = {  # codecs with ffmpeg's options, by a file's suffix; the first one is the default
    ".mp4": {"h264": ["libx264", *_X264], "h265": ["libx265", *_X264, "-tag:v", "hvc1"]},
    ".webm": {"vp9": ["libvpx-vp9", *_WEB], "vp8": ["libvpx", *_WEB]},
    ".webp": {"webp": ["libwebp_anim", "-loop", "0", "-quality", "70", "-compression_level", "4"]},
    ".gif": {"gif": ["gif", "-loop", "0", "-filter_complex", _PALETTE]},
}
_LIFT, _OUTLINE = 0.005, 2.5  # [m] height above the floor, [px] line width
_EVEN = "crop=trunc(iw/2)*2:trunc(ih/2)*2"  # yuv420p needs even sizes


class RecordedLoop(LoopHandle):
    """Recorded snapshots with the interface of the live loop; commands have no effect."""

    def __init__(self, snapshots: Sequence[Snapshot]) -> None:
        super().__init__()
        self.snapshots = tuple(snapshots)  # in order of time, at least one
        self._times, self._at = [snapshot.t for snapshot in self.snapshots], 0

    def go_to(self, t: float) -> Snapshot:
        """Go to the last snapshot at or before `t` [s]; if all are later, go to the first one."""
        self._at = max(bisect_right(self._times, t + 1e-9) - 1, 0)
        return self.latest()

    @property
    def silence(self) -> float:
        return 0.0

    def send(self, command: Command) -> None:
        """Ignore the command."""

    def latest(self) -> Snapshot:
        return self.snapshots[self._at]

    def stored(self, after: float = -1.0) -> list[Stored]:
        """Return the snapshots with t > `after` [s] up to `latest()`, oldest first."""
        return [*map(Stored, self.snapshots[bisect_right(self._times, after) : self._at + 1])]


class OffscreenScene:
    """The dashboard's scene with its default layers, drawn from recorded snapshots."""

    def __init__(
        self,
        server: viser.ViserServer,
        loop: RecordedLoop,
        model: RobotModel,
        clouds: Mapping[str, Cloud],
        look: Look,
        *,
        labels: bool = True,
    ) -> None:
        """Send all constant objects; draw labels if `labels`. Raises the errors of `RobotParts`."""
        self._server, self._loop, self._look = server, loop, look
        self._data = SharedState(loop, model, clouds)
        self._view = View.first(self._data.mobile, [])
        apply_look(self._view, look)
        set_theme(server.gui, dark=look.dark)
        self._scene = Scene(server.scene, self._data, self._view)
        self._scene.canvas.labels = labels
        self._lens: Lens | None = None

    def look(self, shown: Sequence[Snapshot]) -> tuple[np.ndarray, np.ndarray]:
        """Aim the camera at `shown` as `placed` does; return eye and target (3,) [m, world]."""
        window = Window.of(self._look.width, self._look.height)
        eye, target = placed(PRESETS[self._look.view], shown, self._data.parts.extent, window)
        set_first_look(self._server, eye, target)
        self._lens = lens_of(eye, target, self._look.height, window)
        return eye, target

    def outline(self, base_pose: np.ndarray) -> None:
        """Draw a rectangle on the floor: the outline of the base at a pose (3,) [m, m, rad]."""
        fixed = [body for body in self._data.parts.bodies if not body.joint]
        around = np.vstack([body.corners(pin.SE3.Identity()) for body in fixed])
        (x, y, _), (u, v, _) = around.min(axis=0), around.max(axis=0)
        corners = np.array([(x, y, _LIFT), (u, y, _LIFT), (u, v, _LIFT), (x, v, _LIFT)])
        corners = in_world(base_pose, corners)
        ends = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
        colour = np.array(colours.TRAIL_BASE, np.uint8)
        self._server.scene.add_line_segments(
            "/start", ends, colour, thickness=_OUTLINE, thickness_units="screen"
        )

    def draw(self, t: float, *, texts: bool = True) -> None:
        """Draw the last snapshot at or before `t` [s]; update labels and trails only if `texts`."""
        snapshot = self._loop.go_to(t)
        self._data.update()
        self._scene.border.update(self._view, snapshot.border)
        with self._server.atomic():
            self._scene.draw(snapshot, texts=texts, lens=self._lens)


def apply_look(view: View, look: Look) -> None:
    """Set theme, slice and border of a view to those of a look, and hide all other borders."""
    view.dark = look.dark
    view.slice = look.layer != "none"
    pair = look.pair or next((pair for pair, by in view.borders.items() if by != HIDDEN), "")
    view.borders = dict.fromkeys(view.borders, HIDDEN)
    if view.slice and pair in view.borders:
        view.borders[pair] = look.layer


@contextlib.contextmanager
def own_server() -> Iterator[viser.ViserServer]:
    server = open_server(HOST, 0)
    try:
        yield server
    finally:
        close_server(server)


def replay_html(
    log: Trace,
    model: RobotModel,
    clouds: Mapping[str, Cloud],
    look: Look,
    *,
    on_progress: OnProgress = lambda _: None,
) -> str:
    """Return a run as one HTML file that a browser plays without a server or a network.

    The file shows the dashboard's scene, with a bar for the time. After each drawn second of the
    run, `on_progress` gets the drawn share of the run. Raises `AssetError` as `RobotParts`.
    """
    begin, end = log.snapshots[0].t, log.snapshots[-1].t
    with own_server() as server:
        scene = OffscreenScene(server, RecordedLoop(log.snapshots), model, clouds, look)
        scene.look(log.snapshots)
        scene.draw(begin)
        recording = server.get_scene_serializer()
        last = round((end - begin) * RATE)
        for k in range(1, last + 1):
            recording.insert_sleep(1.0 / RATE)
            scene.draw(begin + k / RATE, texts=k == last or k % 5 == 0)
            if k % round(RATE) == 0:
                on_progress(k / last)
        recording.insert_sleep(1.0 / RATE)
        page = recording.as_html(dark_mode=look.dark)
    return _captioned_page(page, log, model.body_names, look.layer)


def write_replay(report: Report, trace: Trace, page: Path) -> None:
    """Write a replay of a trace; the camera has the preset of `first_view`."""
    model, data = loaded(trace.meta.robot, progress=False)
    look = Look(view=first_view(trace.snapshots[0]))
    on_progress = partial(report, "drawing the pictures")
    write_whole(page, replay_html(trace, model, data.clouds, look, on_progress=on_progress))


def _captioned_page(page: str, log: Trace, chain: Sequence[str], layer: Layer) -> str:
    """Insert the run's title for the browser's tab, and a box with title, verdict and legend."""
    methods = ", then ".join(METHOD_WORDS.get(name, name) for name in log.controllers)
    scenario, meaning = log.meta.scenario or "Guiding by hand", _MEANINGS[layer]
    title = escape(f"{log.meta.robot}: {scenario}, {methods}")
    border = f"Coloured points: border around the base; {meaning}. " if meaning else ""
    legend = "Lines: closest points, with distances inside the buffer. Pink: force on the base."
    text = escape(f"{verdict(metrics(log), chain)} {border}{legend}")
    box = (
        '<div style="position:fixed;left:12px;top:12px;max-width:34em;padding:8px 12px;z-index:99;'
        "border-radius:6px;background:rgba(20,22,26,.82);color:white;font:13px/1.4 sans-serif;"
        f'pointer-events:none"><b>{title}</b><br>{text}</div></body>'
    )
    page = re.sub("(?<=<title>).*?(?=</title>)", lambda _: title, page, count=1)
    return box.join(page.rsplit("</body>", 1))


@contextlib.contextmanager
def own_page(browser: web.Browser, look: Look) -> Iterator[tuple[viser.ViserServer, web.Page]]:
    """Run a server and open an empty page in the size of `look`; close both at the end."""
    context = new_context(browser, (look.width, look.height))
    with contextlib.closing(context), own_server() as server:
        yield server, context.new_page()


def send_barrier(server: viser.ViserServer, number: int) -> None:
    """Send a number as the x coordinate of `BARRIER`: it arrives after all earlier messages."""
    server.scene.add_frame(BARRIER, show_axes=False, position=(float(number), 0.0, 0.0))
    server.flush()


def open_page(page: web.Page, server: viser.ViserServer) -> None:
    page.goto(f"http://{HOST}:{server.get_port()}/?fixedDpr=1")
    page.wait_for_function("() => dbbPage.ready()", timeout=1000 * TIMEOUT)


def with_ghosts(shown: Sequence[Snapshot], others: Iterable[Sequence[Snapshot]]) -> list[Snapshot]:
    """Return `shown` with the robots of `others` as ghosts; all sequences have the same times."""
    names = GhostReading._fields
    return [
        replace(s, ghosts=tuple(GhostReading(*(getattr(g, x) for x in names)) for g in ghosts))
        for s, *ghosts in zip(shown, *others, strict=True)
    ]


def film_pictures(
    browser: web.Browser,
    snapshots: Sequence[Snapshot],
    times: Sequence[float],
    model: RobotModel,
    clouds: Mapping[str, Cloud],
    look: Look,
    orbit: float = 0.0,
    framed: Sequence[Snapshot] = (),
) -> Generator[Image.Image, None, None]:
    """Yield the pictures of a film; they do not depend on the duration of the drawing.

    Each picture shows the last snapshot at or before one of `times` [s], with the text of
    `captioned`. Per picture, the camera turns by `orbit` [rad] about the vertical axis through its
    target. In a part of a side-by-side film, `framed` has the snapshots of all robots: the camera
    shows them all, the base's first outline is drawn, and the text is that of `story`. Raises the
    errors of `RobotParts`.
    """
    loop = RecordedLoop(snapshots)
    with own_page(browser, look) as (server, page):
        scene = OffscreenScene(server, loop, model, clouds, look, labels=False)
        server.scene.configure_default_lights(enabled=True, cast_shadow=False)
        eye, target = scene.look(framed or [loop.go_to(t) for t in times])
        first = loop.go_to(times[0])
        if framed:
            scene.outline(first.base_pose)
        scene.draw(times[0])
        open_page(page, server)
        page.add_style_tag(content=ONLY_SCENE)
        ground = css(colours.BACKGROUND[look.dark])
        for k, t in enumerate(times, 1):
            scene.draw(t)
            send_barrier(server, k)
            at = target + pin.utils.rotate("z", (k - 1) * orbit) @ (eye - target)
            values = [BARRIER, k, at.tolist(), target.tolist(), ground]
            jpeg = base64.b64decode(page.evaluate("values => dbbPage.still(values)", values))
            picture, shown = Image.open(io.BytesIO(jpeg)).convert("RGB"), loop.latest()
            if framed:
                yield label(picture, story(shown, first), dark=look.dark)
            else:
                yield captioned(picture, shown, look)


def side_by_side(pictures: Sequence[Image.Image]) -> Image.Image:
    return Image.fromarray(np.hstack([np.asarray(picture) for picture in pictures]))


def story(shown: Snapshot, first: Snapshot) -> list[str | tuple[str, Rgb]]:
    """Return four lines: method, task, clearance, and the base's displacement since `first`."""
    method, near = next(standings(shown))
    moved = float(np.linalg.norm(shown.base_pose[:2] - first.base_pose[:2]))
    task = "a person pulls the end-effector"
    if shown.mode == "tracking":
        task = f"task: the end-effector follows its path, error {millimetres(shown.ee_error)}"
    return [
        method.capitalize(),
        (task, colours.PERSON),
        near if shown.clearance >= 0.0 else (near, COLOURS["contact"]),
        (f"base moved {moved:.2f} m from the outline", colours.TRAIL_BASE),
    ]


def captioned(
    picture: Image.Image, shown: Snapshot, look: Look, *, named: bool = False, posed: bool = False
) -> Image.Image:
    """Write scenario and time into a picture, then method and clearance of each robot.

    If `posed`, the posture is not simulated, and a note replaces scenario and time. If `named`, and
    if there are ghosts, method and clearance are omitted: the picture already has them as labels.
    """
    scenario = f"{shown.scenario}, " if shown.scenario else ""
    first = "Preview, not simulated" if posed else f"{scenario}t = {shown.t:.2f} s"
    lines: list[str | tuple[str, Rgb]] = [first]
    if not (named and shown.ghosts):
        shades = (INK[look.dark], *colours.GHOSTS)
        robots = zip(standings(shown), shades, strict=False)
        lines += [(f"{method}: {near}", colour) for (method, near), colour in robots]
    return label(picture, lines, dark=look.dark)


def write_film(
    path: Path,
    pictures: Iterable[Image.Image],
    rate: float,
    codec: str,
    on_progress: Callable[[int], None] = lambda _: None,
) -> int:
    """Write a film of pictures of equal size, at least one, and return their number.

    The file is written completely or not at all; a failure raises `OutputError`. `rate` [1/s] is
    the frame rate, and `codec` is a codec of the file's suffix in `CODECS`. Before each picture,
    `on_progress` gets the number of pictures written so far.
    """
    from imageio_ffmpeg import get_ffmpeg_exe

    count, rest = 0, iter(pictures)
    first = next(rest)
    size = f"{first.width}x{first.height}"
    name, *more = CODECS[path.suffix.lower()][codec]
    if "-filter_complex" not in more:
        more += ["-vf", _EVEN]
    words = f"-y -loglevel error -f rawvideo -pix_fmt rgb24 -s {size} -r {rate} -i -".split()
    with whole_file(path) as beside, tempfile.TemporaryFile() as said:
        command = [get_ffmpeg_exe(), *words, "-an", "-c:v", name, *more, str(beside)]
        # ffmpeg has its own process group: Ctrl-C reaches this process only, which ends ffmpeg. A
        # file that grows too large causes an error message and no signal, as in this process.
        process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stderr=said,
            start_new_session=True,
            restore_signals=False,
        )
        try:
            assert process.stdin is not None
            with contextlib.suppress(BrokenPipeError):  # ffmpeg has ended; its message follows
                for picture in itertools.chain([first], rest):
                    on_progress(count)
                    process.stdin.write(picture.tobytes())
                    count += 1
                process.stdin.close()
            if process.wait():
                said.seek(0)
                why = said.read().decode(errors="replace").strip() or "ffmpeg reported no reason"
                raise OutputError(f"cannot write {path}: {why.splitlines()[-1]}")
        finally:
            process.kill()
            process.wait()
    return count


def write_film_of(report: Report, trace: Trace, film: Path, look: Look) -> None:
    """Write a film of a trace at true speed, with `RATE` and the default codec of the suffix."""
    report("starting a browser", 0.0)
    with chromium() as browser:  # first, because all later work needs it
        model, data = loaded(trace.meta.robot, progress=False)
        begin, end = trace.snapshots[0].t, trace.snapshots[-1].t
        times = [begin + k / RATE for k in range(1 + int((end - begin) * RATE + 1e-9))]
        pictures = film_pictures(browser, trace.snapshots, times, model, data.clouds, look)

        def on_progress(k: int) -> None:
            report(f"picture {k + 1} of {len(times)}", k / len(times))

        with contextlib.closing(pictures):
            write_film(film, pictures, RATE, next(iter(CODECS[film.suffix])), on_progress)


def label(
    picture: Image.Image, lines: Sequence[str | tuple[str, Rgb]], *, dark: bool
) -> Image.Image:
    """Write lines of text into a picture's upper left corner, and return the picture."""
    size = max(round(_HEIGHT * picture.height), _MIN_HEIGHT)
    font, draw = ImageFont.load_default(size), ImageDraw.Draw(picture)
    for k, line in enumerate(lines):
        text, colour = (line, INK[dark]) if isinstance(line, str) else line
        at = size, size // 2 + round(1.4 * k * size)  # line spacing 1.4
        ground, stroke = colours.BACKGROUND[dark], max(size // 12, 1)
        draw.text(at, text, colour, font, stroke_width=stroke, stroke_fill=ground)
    return picture
