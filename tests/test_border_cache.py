"""A border file returns the written content, and a changed file is refused."""

from __future__ import annotations

import json
import logging
import math
import os
import time
from pathlib import Path

import numpy as np
import pytest

from app.border import cache
from app.border.cache import (
    BorderData,
    DamagedFileError,
    border_key,
    load_border_data,
    read,
    write,
)
from app.border.dbb import make_cloud
from app.border.sampling import SamplingConfig
from app.robot import assets
from app.robot.link_pairs import LinkPairs, Pair
from app.robot.model import RobotModel
from tests.robots import husky_panda

TINY = SamplingConfig(
    pair_samples=2000, cloud_samples=1000, voxel_plan=0.1, voxel_height=0.1, sectors=2, retries=0
)


def content(count: int = 1000) -> BorderData:
    rng = np.random.default_rng(0)
    mobile = (Pair("lm", "lEE"), Pair("lm", "l3"))
    clouds = {
        pair.name: make_cloud(
            pair.name,
            rng.integers(-32000, 32000, (count, 3)).astype(np.int16),
            rng.integers(0, 65535, count).astype(np.uint16),
        )
        for pair in mobile
    }
    rates = {"lm-lEE": 0.07, "lm-l3": 0.03, "lm-l2": 0.0}
    pairs = LinkPairs(mobile, (), (Pair("lm", "l2"),), rates, {"lm-l2": 0.237}, 100, 0)
    return BorderData(pairs, clouds, "sampled")


def assert_same(a: BorderData, b: BorderData) -> None:
    assert a.pairs == b.pairs
    assert a.clouds.keys() == b.clouds.keys()
    for name, cloud in a.clouds.items():
        np.testing.assert_array_equal(cloud.points, b.clouds[name].points)
        np.testing.assert_array_equal(cloud.distances, b.clouds[name].distances)
        assert cloud.points.dtype == b.clouds[name].points.dtype
        assert cloud.distances.dtype == b.clouds[name].distances.dtype


@pytest.mark.parametrize("count", [0, 1, 1000])
def test_reading_a_file_returns_the_written_content(tmp_path, count):
    path = tmp_path / "new" / "x.npz"
    write(path, content(count), "k")
    assert_same(read(path, "k"), content(count))
    assert [file.name for file in path.parent.iterdir()] == ["x.npz"]


def test_the_same_content_gives_the_same_bytes(tmp_path):
    for name in ("a.npz", "b.npz"):
        write(tmp_path / name, content(), "k")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_a_file_of_another_key_or_format_is_refused(tmp_path, monkeypatch):
    path = tmp_path / "x.npz"
    write(path, content(), "k")
    with pytest.raises(DamagedFileError, match="another"):
        read(path, "other")
    monkeypatch.setattr(cache, "FORMAT", cache.FORMAT + 1)
    with pytest.raises(DamagedFileError, match="another"):
        read(path, "k")


def with_header(path: Path, **fields: object) -> Path:
    """The file after a change of some fields of its header."""
    with np.load(path) as file:
        arrays = dict(file)
    header = json.loads(arrays["header"].tobytes()) | fields
    arrays["header"] = np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)
    np.savez(path, **arrays)
    return path


@pytest.mark.parametrize(
    "forged",
    [
        {"format": str(cache.FORMAT)},
        {"rates": {"lm-lEE": -1.0}},
        {"least_distance_m": {"lm-lEE": math.nan}},
        {"mobile": [["lm"]]},
        {"mobile": [["lm", "l9"], ["lm", "l8"], ["lm", "l7"]]},
        {"samples": "many"},
    ],
)
def test_a_header_with_an_invalid_field_is_refused(tmp_path, forged):
    write(tmp_path / "x.npz", content(), "k")
    with pytest.raises(DamagedFileError):
        read(with_header(tmp_path / "x.npz", **forged), "k")


def test_an_unknown_field_of_a_header_has_no_effect(tmp_path):
    write(tmp_path / "x.npz", content(), "k")
    assert_same(read(with_header(tmp_path / "x.npz", newer=1), "k"), content())


def test_a_flipped_byte_or_a_truncated_file_is_detected(tmp_path):
    """The file is refused if zip reads the flipped byte."""
    path = tmp_path / "x.npz"
    write(path, content(50), "k")
    good = path.read_bytes()
    refused = 0
    for at in range(0, len(good), max(1, len(good) // 400)):
        path.write_bytes(good[:at] + bytes([good[at] ^ 0x41]) + good[at + 1 :])
        try:
            assert_same(read(path, "k"), content(50))
        except DamagedFileError:
            refused += 1
    assert refused > 200
    for length in range(0, len(good), max(1, len(good) // 40)):
        path.write_bytes(good[:length])
        with pytest.raises(DamagedFileError):
            read(path, "k")


def test_pickles_are_never_loaded(tmp_path):
    class Trap:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "sprung"),)

    path = tmp_path / "x.npz"
    np.savez(path, header=np.array([Trap()], dtype=object))
    with pytest.raises(DamagedFileError):
        read(path, "k")
    assert not (tmp_path / "sprung").exists()


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    monkeypatch.setattr(assets, "cache_folder", lambda: tmp_path / "cache")
    monkeypatch.setattr(assets, "SHIPPED_CACHE", tmp_path / "shipped")
    return tmp_path


def load(**options):
    return load_border_data(husky_panda(), sampling=TINY, progress=False, processes=1, **options)


def test_the_first_call_samples_and_later_calls_read_the_file(folder, monkeypatch):
    first = load()
    assert first.origin == "sampled"
    monkeypatch.setattr(cache, "sample_clouds", None)  # a second sampling would fail
    again = load()
    assert again.origin == "cache"
    assert_same(first, again)
    assert all(len(cloud) > 20 for cloud in again.clouds.values())
    (folder / "cache").rename(folder / "shipped")
    assert load().origin == "shipped"


def test_the_border_of_another_robot_with_equal_inputs_is_used(folder):
    """An example is a robot that was saved under a new name with another ready posture."""
    first = load()
    (file,) = (folder / "cache").glob("*.npz")
    file.rename(file.with_name(file.name.replace("husky_panda", "another")))
    again = load()
    assert (first.origin, again.origin) == ("sampled", "cache")
    assert_same(first, again)


@pytest.mark.parametrize("damage", [b"", b"not a zip", b"PK\x03\x04" + bytes(200)])
def test_a_damaged_file_is_sampled_again_with_one_warning(folder, damage, caplog):
    load()
    (path,) = (folder / "cache").iterdir()
    path.write_bytes(damage)
    caplog.clear()
    with caplog.at_level(logging.WARNING):
        assert load().origin == "sampled"
    assert len(caplog.records) == 1
    assert str(path) in caplog.text
    assert load().origin == "cache"


def test_a_cache_that_cannot_be_written_gives_only_a_warning(folder, caplog):
    (folder / "cache").write_text("a file where the folder should be")
    assert load().origin == "sampled"
    assert "cannot be stored" in caplog.text
    assert (folder / "cache").is_file()


def changed_key(change) -> str:
    description = husky_panda().description
    return border_key(change(description), TINY)


def test_the_key_depends_on_bodies_limits_and_sampling_only():
    description = husky_panda().description
    key = border_key(description, TINY)
    first, *others = description.bodies
    box = first.shapes[0]
    larger = box.model_copy(update={"size_m": (1.0, 0.69, 0.3803)})
    bodies = (first.model_copy(update={"shapes": (larger,)}), *others)
    limits = (*description.arm.position_lower[:-1], -2.0)
    arm = description.arm.model_copy(update={"position_lower": limits})
    assert changed_key(lambda d: d.model_copy(update={"bodies": bodies})) != key
    assert changed_key(lambda d: d.model_copy(update={"arm": arm})) != key
    assert border_key(description, TINY.model_copy(update={"seed": 1})) != key
    other_title = description.model_copy(update={"title": "x", "licence": "y"})
    assert border_key(other_title, TINY) == key
    resourced = (first.model_copy(update={"source": "elsewhere"}), *others)
    assert changed_key(lambda d: d.model_copy(update={"bodies": resourced})) == key


def test_the_key_ignores_the_assets_folder_and_urdf_comments(tmp_path, monkeypatch):
    key = border_key(husky_panda().description, TINY)
    moved = tmp_path / "robot_assets" / "husky_panda"
    moved.mkdir(parents=True)
    urdf = (assets.ASSETS / "husky_panda" / "robot.urdf").read_text()
    (moved / "robot.urdf").write_text(urdf.replace("<link", "<!-- a remark -->\n  <link"))
    monkeypatch.setattr(assets, "ASSETS", tmp_path / "robot_assets")
    assert border_key(husky_panda().description, TINY) == key
    (moved / "robot.urdf").write_text(urdf.replace("0.333", "0.334"))
    assert border_key(husky_panda().description, TINY) != key


def test_the_papers_border_is_shipped_small_and_loads_quickly():
    model: RobotModel = husky_panda()
    path = (
        assets.SHIPPED_CACHE / f"husky_panda-{border_key(model.description, SamplingConfig())}.npz"
    )
    assert path.is_file(), "run `dbb border`, then commit the new file of dbb_cache/"
    assert path.stat().st_size < 10e6
    start = time.process_time()
    data = load_border_data(model)
    assert time.process_time() - start < 1.0  # [s]
    assert data.origin in ("cache", "shipped")
    assert [pair.name for pair in data.pairs.mobile] == list(data.clouds) == ["lm-lEE", "lm-l3"]
