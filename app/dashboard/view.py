"""View of one viewer: layers, colours and plots that the viewer has chosen."""

from dataclasses import dataclass, field, replace
from typing import Any, Literal

from app.dashboard.scene.legend import QUANTITIES

HIDDEN = "hidden"  # choice for a border that is not drawn
CHOICES = (*reversed(QUANTITIES), HIDDEN)  # choices for the colour of a border
LABELS = "active", "all", "none"  # choices for the labels
BORDER, LAYERS, PAGE = "Border coloured by", "Layers", "Camera and page"  # folders of the tab


def _shown(folder: str, label: str, first: bool | str, hint: str | None = None) -> Any:
    """Declare a field by its default `first`, and by folder, label and hint of its widget."""
    return field(default=first, metadata={"folder": folder, "label": label, "hint": hint})


@dataclass
class View:
    """Choices of a viewer. Callbacks assign to the fields; the drawing thread reads them."""

    borders: dict[str, str]  # by the pair: one of `QUANTITIES`, or `HIDDEN`
    whole_border: bool = _shown(
        BORDER, "Include the top", False, "Show the border above the base too; it can hide the arm"
    )
    slice: bool = _shown(
        BORDER, "Slice at the arm", True, "Contour at the height of the arm's nearest point"
    )
    meshes: bool = _shown(LAYERS, "Robot", True)
    bodies: bool = _shown(LAYERS, "Convex bodies", False, "Convex bodies used for distances")
    distances: bool = _shown(LAYERS, "Closest points", True)
    labels: Literal["active", "all", "none"] = _shown(
        LAYERS,
        "Labels",
        "active",
        "active: distances of pairs inside their buffer; all: all distances and symbols of points",
    )
    acting: bool = _shown(
        LAYERS, "Acting points", True, "Points p_act, p_n and p_t, and the force on the base"
    )
    motion: bool = _shown(
        LAYERS, "Forces", True, "Force of the person, and commanded acceleration of the base"
    )
    trails: bool = _shown(LAYERS, "Trails", True, "Past paths of base and end-effector")
    follow: bool = _shown(
        PAGE,
        "Follow the base",
        True,
        "With ghosts the camera moves only if a robot leaves the picture",
    )
    dark: bool = _shown(PAGE, "Dark theme", True)
    light: bool = _shown(
        PAGE,
        "Low detail",
        False,
        "Fewer triangles, points and pictures per second, no shadows; the default without a GPU",
    )
    plots: set[str] = field(default_factory=set)  # titles of the shown plots

    def toggle_dark(self) -> None:
        self.dark = not self.dark

    def of_robot(self, pairs: list[str], plots: list[str]) -> "View":
        """Return the same choices for another robot, from its pairs of L_m and its plots' titles.

        If borders are shown, but the other robot has none of them, its first one shows the score.
        """
        borders = {pair: self.borders.get(pair, HIDDEN) for pair in pairs}
        if set(borders.values()) <= {HIDDEN} and set(self.borders.values()) - {HIDDEN}:
            borders = View.first(pairs, plots).borders
        return replace(self, borders=borders, plots=self.plots & set(plots))

    @classmethod
    def first(cls, pairs: list[str], plots: list[str]) -> "View":
        """Return the default: the first border, coloured by its score, and the first four plots."""
        borders = dict.fromkeys(pairs, HIDDEN)
        if pairs:
            borders[pairs[0]] = "score"
        return cls(borders, plots=set(plots[:4]))
