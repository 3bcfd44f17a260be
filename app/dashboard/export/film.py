"""Films without a display: drawn picture by picture from snapshots, encoded as they come."""

from __future__ import annotations

import base64
import io
import itertools
import math
import subprocess
import tempfile
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pinocchio as pin
from PIL import Image

from app.border.dbb import Cloud
from app.dashboard.export.offscreen import (
    BARRIER,
    ONLY_SCENE,
    Look,
    OffscreenScene,
    RecordedLoop,
    label,
    middle,
    open_page,
    own_page,
    send_barrier,
)
from app.dashboard.scene.colours import BACKGROUND, GHOSTS, Rgb
from app.errors import OutputError
from app.robot.model import RobotModel
from app.simulation.trace.snapshot import GhostReading, Snapshot
from app.system import whole_file

if TYPE_CHECKING:
    import playwright.sync_api as web

_WEB = [
    "-cpu-used",
    "5",
    "-row-mt",
    "1",
    "-deadline",
    "good",
    "-b:v",
    "0",
    "-crf",
    "32",
    "-pix_fmt",
    "yuv420p",
]
_X264 = ["-crf", "20", "-pix_fmt", "yuv420p", "-movflags", "+faststart"]
_PALETTE = "split[a][b];[a]palettegen[p];[b][p]paletteuse=dither=bayer"
CODECS = {
    ".mp4": {"h264": ["libx264", *_X264], "h265": ["libx265", *_X264, "-tag:v", "hvc1"]},
    ".webm": {"vp9": ["libvpx-vp9", *_WEB], "vp8": ["libvpx", *_WEB]},
    ".webp": {"webp": ["libwebp_anim", "-loop", "0", "-quality", "70", "-compression_level", "4"]},
    ".gif": {"gif": ["gif", "-loop", "0", "-filter_complex", _PALETTE]},
}
"""By the ending of a file: its codecs, the usual one first, each with what ffmpeg needs."""
_EVEN = "crop=trunc(iw/2)*2:trunc(ih/2)*2"
"""Both have two chroma samples a pixel row and column."""


def with_ghosts(led: Sequence[Snapshot], others: Iterable[Sequence[Snapshot]]) -> list[Snapshot]:
    """A run with other runs of the same times as its ghosts."""
    return [
        replace(main, ghosts=tuple(map(_ghost, ghosts)))
        for main, *ghosts in zip(led, *others, strict=True)
    ]


def film_pictures(
    browser: web.Browser,
    snapshots: Sequence[Snapshot],
    times: Sequence[float],
    model: RobotModel,
    clouds: Mapping[str, Cloud],
    look: Look,
    orbit: float = 0.0,
) -> Generator[Image.Image, None, None]:
    """The pictures of a film, one by one; none depends on how long it took.

    Args:
        browser: Its page is opened and closed here.
        snapshots: In order of time.
        times: [s] of the pictures; each shows the last snapshot that is not later.
        model: The robot.
        clouds: P_i of every pair of L_m, by the pair's name.
        look: What they show.
        orbit: [rad] by which the camera turns around the robot from one picture to the next.

    Raises:
        BrowserError: Its page does not open.
        AssetError: A mesh of the robot is not there.
    """
    loop = RecordedLoop(snapshots)
    with own_page(browser, look) as (server, page):
        scene = OffscreenScene(server, loop, model, clouds, look, labels=False)
        server.scene.configure_default_lights(enabled=True, cast_shadow=False)
        eye, target = scene.look(look.view, middle([loop.go_to(t) for t in times]))
        scene.draw(times[0])
        open_page(page, server)
        page.add_style_tag(content=ONLY_SCENE)
        ground = "rgb({}, {}, {})".format(*BACKGROUND[look.dark])
        for k, t in zip(itertools.count(1), times):
            scene.draw(t)
            send_barrier(server, k)
            at = target + pin.utils.rotate("z", (k - 1) * orbit) @ (eye - target)
            told = [BARRIER, k, at.tolist(), target.tolist(), ground]
            jpeg = base64.b64decode(page.evaluate("told => dbbPage.still(told)", told))
            picture = Image.open(io.BytesIO(jpeg)).convert("RGB")
            yield captioned(picture, loop.go_to(t), dark=look.dark)


def captioned(picture: Image.Image, snapshot: Snapshot, *, dark: bool) -> Image.Image:
    """The picture with time, and each robot's least distance d to its base, with β, on it."""
    near = min((p for p in snapshot.pairs if p.mobile), key=lambda p: p.d, default=None)
    lines: list[str | tuple[str, Rgb]] = [f"t = {snapshot.t:.2f} s"]
    if near is not None:
        text = f"{snapshot.controller}:  d = {_distance(near.d)},  beta = {near.beta:.2f}"
        lines.append(text)
    for ghost, colour in zip(snapshot.ghosts, itertools.cycle(GHOSTS)):
        lines.append((f"{ghost.controller}:  d = {_distance(ghost.clearance)}", colour))
    return label(picture, lines, dark=dark)


def write_film(
    path: Path,
    pictures: Iterable[Image.Image],
    rate: float,
    codec: str,
    on_progress: Callable[[int], None] = lambda _: None,
) -> int:
    """Encode pictures as they come; the file is written whole or not at all.

    Args:
        path: Its ending is a key of `CODECS`.
        pictures: Of one size, at least one.
        rate: [1/s] of them.
        codec: One of the ending's.
        on_progress: Called with how many are written before each one.

    Returns:
        How many there were.

    Raises:
        OutputError: It cannot be written.
    """
    from imageio_ffmpeg import get_ffmpeg_exe

    suffix, count = path.suffix.lower(), 0
    given = iter(pictures)
    first = next(given)
    size = f"{first.width}x{first.height}"
    name, *more = CODECS[suffix][codec]
    if "-filter_complex" not in more:
        more += ["-vf", _EVEN]
    words = f"-y -loglevel error -f rawvideo -pix_fmt rgb24 -s {size} -r {rate} -i -".split()
    with whole_file(path) as beside, tempfile.TemporaryFile() as said:
        command = [get_ffmpeg_exe(), *words, "-an", "-c:v", name, *more, str(beside)]
        # In a group of its own: Ctrl-C is for this process, which ends the other one.
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stderr=said, start_new_session=True
        )
        try:
            assert process.stdin is not None
            with suppress(BrokenPipeError):  # it has ended, and says why
                for picture in itertools.chain([first], given):
                    on_progress(count)
                    process.stdin.write(picture.tobytes())
                    count += 1
                process.stdin.close()
            if process.wait():
                said.seek(0)
                why = said.read().decode(errors="replace").strip().splitlines() or ["no reason"]
                raise OutputError(f"cannot write {path}: {why[-1]}")
        finally:
            process.kill()
            process.wait()
    return count


def _ghost(s: Snapshot) -> GhostReading:
    near = min((pair.d for pair in s.pairs if pair.mobile), default=math.inf)
    return GhostReading(s.controller, s.base_pose, s.q_m, s.wheel_angles, s.p_ee, near)


def _distance(d: float) -> str:
    return f"{1000 * d:.0f} mm" + (", contact" if d < 0 else "")
