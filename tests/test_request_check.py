"""The input of `dbb new-robot`: one check of its numbers, for the command and for the page."""

from __future__ import annotations

from pathlib import Path

import pytest

from app.errors import ConfigError, UnknownNameError
from app.onboarding.request import BOUNDS, Request, check_request


def toy_request(**fields: object) -> Request:
    return Request("toy.urdf", "base", "hand", Path("toy"), **fields)  # type: ignore[arg-type]


@pytest.mark.parametrize("field", BOUNDS)
def test_number_is_accepted_within_its_bounds_and_for_its_kind_of_base(field: str) -> None:
    bounds, kind = BOUNDS[field], BOUNDS[field].kind or "differential"
    others = {"half_track": 0.3} if field == "wheel_radius" else {}
    for value in (bounds.low, bounds.high):
        check_request(toy_request(kind=kind, **others, **{field: value}))
    option = "--" + field.replace("_", "-")
    for value in (bounds.low * 0.99, bounds.high * 1.01, float("nan"), 0.0):
        with pytest.raises(ConfigError, match=f"{option}: .* is not within"):
            check_request(toy_request(kind=kind, **others, **{field: value}))
    if bounds.kind:
        with pytest.raises(ConfigError, match=f"{option}: a holonomic base does not.*{kind}"):
            check_request(toy_request(kind="holonomic", **{field: bounds.high}))


def test_contradictory_options_are_refused() -> None:
    for words, fields in (
        ("--wheels: a holonomic base", {"kind": "holonomic", "wheels": ("l", "r")}),
        ("--wheel-radius: needs --half-track", {"wheel_radius": 0.1}),
        ("--mount-xyz: places an arm with its own URDF", {"mount_xyz": (0.1, 0.0, 0.0)}),
        ("--mount-rpy: places an arm with its own URDF", {"mount_rpy": (0.0, 0.0, 0.1)}),
        ("and excludes --wheels", {"wheel_radius": 0.1, "half_track": 0.3, "wheels": ("l", "r")}),
    ):
        with pytest.raises(ConfigError, match=words):
            check_request(toy_request(**fields))
    with pytest.raises(UnknownNameError, match="choose from: car-like, differential, holonomic"):
        check_request(toy_request(kind="hovering"))
