"""Canvas: points, lines, arrows, labels and boxes of one picture after the other."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Literal

import numpy as np
import pinocchio as pin
import viser

from app.dashboard.scene.colours import Rgb, linear

Array = np.ndarray
Anchor = Literal["bottom-left", "top-left", "bottom-right", "top-right"]

ROOT = "/robot"
"""Scene node that moves with the base: origin on the floor below the base's centre, x forward."""
METRES_PER_NEWTON = 1 / 400  # [m/N] of a force: 0.1 m is 40 N
METRES_PER_ACCELERATION = 0.2  # [s²] of v̇: 0.2 m is 1 m/s²
HEAD_LENGTH = 0.035  # [m] of an arrow


class Canvas:
    """What is drawn during a picture is seen, and all else of the canvas is hidden.

    A node is sent when it is drawn first; from then on viser sends what has changed of it.

    Attributes:
        labels: Whether labels are drawn; a page lays their texts out aside, so they may come late.
    """

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self.labels = True
        self._handles: dict[str, Any] = {}
        self._drawn: set[str] = set()
        self._texts = True

    @contextmanager
    def picture(self, *, texts: bool) -> Iterator[None]:
        """Draw anew; the texts of labels that were there change only if `texts`."""
        self._drawn, self._texts = set(), texts
        yield
        for name, handle in self._handles.items():
            handle.visible = name in self._drawn

    def point(self, name: str, place: Array, colour: Rgb, radius: float) -> None:
        """A ball of a radius [m] at a place (3,) [m]."""
        node = self._node(
            name,
            lambda: self._scene.add_icosphere(
                name, radius=radius, color=colour, cast_shadow=False, visible=False
            ),
        )
        node.position = place

    def label(self, name: str, place: Array, text: str, anchor: Anchor = "top-left") -> None:
        """A text at a place (3,) [m], which is its corner `anchor`."""
        if not self.labels:
            return
        node = self._node(
            name,
            lambda: self._scene.add_label(
                name, text, anchor=anchor, font_screen_scale=0.85, visible=False
            ),
        )
        node.position, node.anchor = place, anchor
        if self._texts:
            node.text = text

    def lines(self, name: str, lines: Sequence[Array], colour: Rgb, pixels: float) -> None:
        """Lines of one colour through points (K, 3) [m] each, K ≥ 2.

        viser takes colours of single segments for linear ones, which washes them out, and a line
        that goes over to them stays white now and then.
        """
        segments = [np.stack([points[:-1], points[1:]], axis=1) for points in lines]
        self.segments(name, np.concatenate(segments), np.array(colour, np.uint8), pixels)

    def segments(self, name: str, ends: Array, colours: Array, pixels: float) -> None:
        """Straight lines between ends (N, 2, 3) [m]; see `lines`.

        Colours are uint8: (3,) of all, or (N, 2, 3), which viser takes as linear in light.
        """
        node = self._node(
            name,
            lambda: self._scene.add_line_segments(
                name, ends, colours, thickness=pixels, thickness_units="screen", visible=False
            ),
        )
        node.colors = colours
        node.points = ends

    def arrow(self, name: str, start: Array, end: Array, colour: Rgb) -> None:
        """An arrow between two places (3,) [m]."""
        ends = np.array([[start, end]])
        node = self._node(
            name,
            lambda: self._scene.add_arrows(
                name,
                ends,
                linear(np.array([colour]))[0],
                shaft_radius=0.008,
                head_radius=0.020,
                head_length=HEAD_LENGTH,
                visible=False,
            ),
        )
        node.points = ends

    def box(
        self, name: str, T: pin.SE3, size: Sequence[float], colour: Rgb, opacity: float | None
    ) -> None:
        """A box of a size (3,) [m] whose middle is at a pose."""
        node = self._node(
            name, lambda: self._scene.add_box(name, color=colour, opacity=opacity, visible=False)
        )
        node.dimensions = tuple(map(float, size))
        node.position, node.wxyz = to_viser(T)

    def _node(self, name: str, send: Callable[[], Any]) -> Any:
        self._drawn.add(name)
        if name not in self._handles:
            self._handles[name] = send()
        return self._handles[name]


def to_viser(T: pin.SE3) -> tuple[Array, Array]:
    """Position (3,) [m] and quaternion wxyz (4,) of a pose."""
    xyzquat = np.array(pin.SE3ToXYZQUAT(T))
    return xyzquat[:3], xyzquat[[6, 3, 4, 5]]


def from_viser(position: Array, wxyz: Array) -> pin.SE3:
    """The pose of a position (3,) [m] and a quaternion wxyz (4,)."""
    return pin.XYZQUATToSE3(np.concatenate([position, wxyz[1:], wxyz[:1]]))
