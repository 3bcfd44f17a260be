"""Pictures and replays, drawn without a display."""

from dataclasses import dataclass
from typing import Literal

from app.strict import check_range

Layer = Literal["determinant", "reachability", "score", "none"]
Side = Literal["iso", "top", "front", "side", "hand", "pair", "door"]
"""Keys of `app.dashboard.scene.camera.PRESETS`."""
_SIZES = 64, 8192  # [px]


@dataclass(frozen=True)
class Look:
    """What a picture shows, and how large it is."""

    width: int = 1280
    """[px] of each picture."""
    height: int = 720
    """[px] of each picture."""
    layer: Layer = "score"
    """What the border is coloured by; none hides it."""
    view: Side = "iso"
    """Where the scene is looked at from."""
    page: bool = False
    """The whole dashboard, not the scene alone."""
    light: bool = False
    """A light ground, not a dark one."""
    pair: str = ""
    """The pair of L_m whose border it is; the first one by default."""

    def __post_init__(self) -> None:
        check_range("--width", self.width, *_SIZES, "px")
        check_range("--height", self.height, *_SIZES, "px")

    @property
    def dark(self) -> bool:
        """A dark ground."""
        return not self.light
