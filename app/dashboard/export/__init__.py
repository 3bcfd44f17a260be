"""Pictures, films and replays without a display; `Look` describes their content and size."""

from dataclasses import dataclass
from typing import Literal

from app.strict import check_range

Layer = Literal["determinant", "reachability", "score", "none"]
Side = Literal["iso", "top", "front", "side", "end-effector", "pair", "door"]
"""Keys of `app.dashboard.scene.camera.PRESETS`."""
_SIZES = 64, 8192  # [px] smallest and largest width or height


@dataclass(frozen=True)
class Look:
    """Content and size of a picture; raises `ConfigError` for a size outside of `_SIZES`."""

    width: int = 1280
    """[px] width of each picture."""
    height: int = 720
    """[px] height of each picture."""
    layer: Layer = "score"
    """Quantity that colours the border; "none" hides the border."""
    view: Side = "iso"
    """Camera view of the scene."""
    page: bool = False
    """Whether the picture shows the whole dashboard, not the scene alone."""
    light: bool = False
    """Whether the background is light, not dark."""
    pair: str = ""
    """Pair of L_m whose border is shown; by default the first one."""

    def __post_init__(self) -> None:
        check_range("--width", self.width, *_SIZES, "px")
        check_range("--height", self.height, *_SIZES, "px")

    @property
    def dark(self) -> bool:
        return not self.light
