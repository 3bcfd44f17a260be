"""The border of a robot, from a file if there is one, else sampled once and kept."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from app.border import archive
from app.border.checked_file import DamagedFileError
from app.border.cloud import Cloud
from app.border.key import FORMAT, border_key
from app.border.sampling.config import SamplingConfig
from app.robot import assets
from app.robot.link_pairs import LinkPairs, find_link_pairs
from app.robot.model import RobotModel

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class BorderData:
    """All that is made offline for one robot.

    Attributes:
        pairs: §2.1, the pairs of (1).
        clouds: P_i of Algorithm 1, by the name of the pair of L_m.
        origin: Where it came from: the cache, a file shipped with the project, or sampled now.
    """

    pairs: LinkPairs
    clouds: dict[str, Cloud]
    origin: Literal["cache", "shipped", "sampled"]


def load_border_data(
    model: RobotModel,
    *,
    sampling: SamplingConfig | None = None,
    progress: bool = True,
    processes: int | None = None,
    on_progress: Callable[[float], None] | None = None,
) -> BorderData:
    """Pairs and clouds of a robot.

    A file that is damaged or of another robot is never believed: it is sampled anew, with a
    warning. A cache that cannot be written costs a warning and the time to sample again.

    Args:
        model: The robot.
        sampling: How to sample; the default is what the shipped file was made with.
        progress: Whether to draw a bar on stderr while sampling.
        processes: How many to sample with; all cores if not given.
        on_progress: Called with the share that is sampled, 0 to 1.

    Raises:
        AssetError: The URDF or a mesh is not there.
        DescriptionError: The mobile robot is too large to be kept.
    """
    sampling = sampling or SamplingConfig()
    if (found := kept_border_data(model, sampling)) is not None:
        return found
    # Imported here: a control step of a robot whose border is kept needs no sampling.
    from app.border.sampling.pairs import sample_clouds

    pairs = find_link_pairs(model, samples=sampling.pair_samples, seed=sampling.seed)
    clouds = sample_clouds(
        model,
        pairs.mobile,
        sampling,
        progress=progress,
        processes=processes,
        on_progress=on_progress,
    )
    key = border_key(model.description, sampling)
    _write(assets.cache_folder() / _name(model, key), archive.Content(pairs, clouds), key)
    return BorderData(pairs, clouds, "sampled")


def kept_border_data(
    model: RobotModel, sampling: SamplingConfig | None = None
) -> BorderData | None:
    """Pairs and clouds of a robot if they need not be sampled, else None.

    Raises:
        AssetError: The URDF or a mesh is not there.
    """
    key = border_key(model.description, sampling or SamplingConfig())
    name = _name(model, key)
    if content := _read(assets.cache_folder() / name, key):
        return BorderData(content.pairs, content.clouds, "cache")
    if content := _read(assets.SHIPPED_CACHE / name, key):
        return BorderData(content.pairs, content.clouds, "shipped")
    return None


def _name(model: RobotModel, key: str) -> str:
    return f"{model.description.name}-{key}.npz"


def _read(path: Path, key: str) -> archive.Content | None:
    try:
        return archive.read(path, key=key, layout=FORMAT)
    except FileNotFoundError:
        return None
    except DamagedFileError as error:
        _log.warning("%s is not used: %s", path, error)
        return None


def _write(path: Path, content: archive.Content, key: str) -> None:
    try:
        archive.write(path, content, key=key, layout=FORMAT)
    except OSError as error:
        _log.warning("%s cannot be kept (%s); it will be sampled again", path, error.strerror)
