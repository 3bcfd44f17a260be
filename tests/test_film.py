"""Films without a display: written completely or not at all, and reproducible."""

from __future__ import annotations

import resource
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from imageio_ffmpeg import count_frames_and_secs, read_frames
from PIL import Image

from app.border.cache import BorderData
from app.cli.main import main
from app.config import Config
from app.dashboard.export import Look
from app.dashboard.export.offscreen import (
    CODECS,
    captioned,
    film_pictures,
    side_by_side,
    story,
    with_ghosts,
    write_film,
)
from app.errors import OutputError
from app.robot.model import RobotModel
from app.simulation.case import RunSpec
from app.simulation.run import filmed
from app.simulation.scenarios import scenario_of
from app.simulation.trace.snapshot import Snapshot

SIZE = 64, 48  # [px]
RATE = 10.0  # [1/s]


def grey(count: int) -> Iterator[Image.Image]:
    """Pictures from dark to light."""
    for k in range(count):
        yield Image.new("RGB", SIZE, (40 * k,) * 3)


def frames(path: Path) -> list[np.ndarray]:
    """(H, W, 3) uint8 of each picture, read by independent libraries."""
    if path.suffix in (".gif", ".webp"):
        with Image.open(path) as film:
            found = []
            for k in range(getattr(film, "n_frames", 1)):
                film.seek(k)
                found.append(np.array(film.convert("RGB")))
        return found
    reader = read_frames(str(path))
    width, height = next(reader)["size"]
    return [np.frombuffer(f, np.uint8).reshape(height, width, 3) for f in reader]


@pytest.mark.parametrize(
    ("suffix", "codec"), [(suffix, codec) for suffix, each in CODECS.items() for codec in each]
)
def test_each_codec_keeps_every_picture_in_order(suffix: str, codec: str, tmp_path: Path) -> None:
    path = tmp_path / f"film{suffix}"
    assert write_film(path, grey(5), RATE, codec) == 5
    found = frames(path)
    assert [f.shape for f in found] == [(SIZE[1], SIZE[0], 3)] * 5
    assert [f.mean() for f in found] == pytest.approx([0, 40, 80, 120, 160], abs=6)
    if suffix in (".mp4", ".webm"):
        count, seconds = count_frames_and_secs(str(path))
        assert (count, seconds) == (5, pytest.approx(0.5, abs=0.05))
    assert list(tmp_path.iterdir()) == [path]


def test_ffmpeg_failure_is_one_line_and_keeps_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    full = tmp_path / "ffmpeg"
    full.write_text(
        '#!/bin/sh\nfor last; do :; done\necho half > "$last"\n'
        "echo 'av_interleaved_write_frame(): No space left on device' >&2\nexit 1\n"
    )
    full.chmod(0o755)
    monkeypatch.setattr("imageio_ffmpeg.get_ffmpeg_exe", lambda: str(full))
    path = tmp_path / "film.mp4"
    path.write_bytes(b"old")
    with pytest.raises(OutputError, match=r"film\.mp4: .*No space left on device$"):
        write_film(path, grey(200), RATE, "h264")
    assert path.read_bytes() == b"old"
    assert sorted(tmp_path.iterdir()) == [full, path]


def test_exceeded_file_size_limit_is_one_line(tmp_path: Path) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (30, 240, 320, 3), dtype=np.uint8)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, hard))
    try:
        with pytest.raises(OutputError, match=r"film\.mp4: .*File too large"):
            write_film(tmp_path / "film.mp4", map(Image.fromarray, noise), RATE, "h264")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert list(tmp_path.iterdir()) == []


def test_ctrl_c_leaves_no_file(tmp_path: Path) -> None:
    def pictures() -> Iterator[Image.Image]:
        yield from grey(3)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_film(tmp_path / "film.webm", pictures(), RATE, "vp9")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "error"),
    [
        ("--out x.avi", "--out: x.avi must end in .mp4 or .webm or .webp or .gif"),
        ("--out x.mp4 --codec vp9", "unknown --codec of .mp4 'vp9'"),
        ("--out x.mp4 --beside nobody", "unknown controller of --beside 'nobody'"),
        ("--out x.mp4 --side-by-side", "--side-by-side needs --beside CONTROLLER"),
        ("--out x.mp4 --rate 0", "--rate: 0 1/s is not within 1 to 60 1/s"),
        ("--out x.mp4 --span 3 2", "--span: the start: 3 s is not within 0 to 2 s"),
        ("--out x.mp4 --span 0 99", "--span: 99 s is not within 0 to 8 s"),
    ],
)
def test_invalid_arguments_are_one_line(
    words: str,
    error: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit):
        main(["film", "guiding-front", *words.split()])
    [line] = capsys.readouterr().err.strip().splitlines()
    assert error in line
    assert not list(tmp_path.glob("*.*"))


@pytest.fixture(scope="module")
def run(robot: RobotModel, border_data: BorderData) -> list[Snapshot]:
    """Snapshots at 0 s and 0.1 s of a run, with a ghost."""
    scenario = scenario_of(robot.description, "guiding-front")
    both = [
        filmed(RunSpec("husky_panda", scenario, Config(), name), robot, border_data, [0.0, 0.1])
        for name in ("dbb", "none")
    ]
    return with_ghosts(both[0], both[1:])


def test_caption_changes_with_time_and_ghost(run: list[Snapshot]) -> None:
    how = (Look(),)
    plain = Image.new("RGB", (640, 360), (20, 20, 20))
    one = np.array(captioned(plain.copy(), run[0], *how))
    other = np.array(captioned(plain.copy(), run[-1], *how))
    alone = np.array(captioned(plain.copy(), replace(run[0], ghosts=()), *how))
    assert (alone != 20).any()
    assert (one != other).any()
    assert (one != alone).any(axis=-1).sum() > 100  # the ghost's line


def test_caption_of_a_posture_has_no_time(run: list[Snapshot]) -> None:
    def drawn(t: float, *, posed: bool) -> np.ndarray:
        plain = Image.new("RGB", (640, 360), (20, 20, 20))
        return np.array(captioned(plain, replace(run[0], t=t), Look(), posed=posed))

    np.testing.assert_array_equal(drawn(1.0, posed=True), drawn(24.32, posed=True))
    assert (drawn(24.32, posed=True) != drawn(24.32, posed=False)).any()


def test_story_names_method_cause_distance_and_base_motion(run: list[Snapshot]) -> None:
    x, y, phi = run[0].base_pose
    gone = replace(run[0], base_pose=np.array([x + 0.3, y - 0.4, phi]))
    texts = [line if isinstance(line, str) else line[0] for line in story(gone, run[0])]
    assert texts[0] == "With avoidance"
    assert texts[1] == "a person pulls the end-effector"
    assert texts[2].startswith("arm ")
    assert texts[2].endswith(" mm from its base")
    assert texts[3] == "base moved 0.50 m from the outline"
    inside = [pair._replace(d=-0.01) for pair in run[0].pairs]
    without = replace(run[0], controller="none", mode="tracking", ee_error=0.086, pairs=inside)
    texts = [line if isinstance(line, str) else line[0] for line in story(without, run[0])]
    assert texts[0] == "Without avoidance"
    assert texts[1] == "task: the end-effector follows its path, error 86 mm"
    assert texts[2] == "arm overlaps its base by 10 mm"


def test_side_by_side_pictures_keep_their_order() -> None:
    pairs = zip(grey(3), reversed(list(grey(3))), strict=True)
    wholes = [side_by_side(pair) for pair in pairs]
    assert [whole.size for whole in wholes] == [(2 * SIZE[0], SIZE[1])] * 3
    assert [(w.getpixel((0, 0))[0], w.getpixel((SIZE[0], 0))[0]) for w in wholes] == [
        (0, 80),
        (40, 40),
        (80, 0),
    ]


@pytest.mark.browser
def test_film_is_reproducible_and_orbits(
    browser: object, run: list[Snapshot], robot: RobotModel, border_data: BorderData
) -> None:
    look = Look(160, 90)

    def film(orbit: float) -> list[np.ndarray]:
        times = [0.0, 0.1]
        args = (browser, run, times, robot, border_data.clouds, look, orbit)
        return [np.array(picture) for picture in film_pictures(*args)]  # type: ignore[arg-type]

    one, two = film(0.0)
    assert one.shape == (90, 160, 3)
    assert one.std() > 10  # the robot is visible
    again, turned = film(0.5)
    assert (again == one).all()
    assert (np.abs(turned.astype(int) - two) > 24).mean() > 0.1
