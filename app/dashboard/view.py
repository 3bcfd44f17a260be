"""What the viewers have chosen to see. Callbacks assign a field, the drawing thread reads it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Quantity = Literal["determinant", "reachability", "score", "hidden"]


@dataclass
class View:
    """Layers of the scene; each field is one assignment of a callback."""

    pair: str
    """Link pair of L_m whose border is drawn."""
    quantity: Quantity = "score"
    """What the border is coloured by."""
    whole_border: bool = False
    """Also the part of the border above the base's top, which hides the arm."""
    meshes: bool = True
    bodies: bool = False
    distances: bool = True
    """Lines between the closest points of the pairs."""
    labels: Literal["active", "all", "none"] = "active"
    """Which of these lines carry their distance."""
    acting: bool = True
    """Acting points and forces."""
    follow: bool = False
    """Whether the cameras follow the base."""
    dark: bool = True
