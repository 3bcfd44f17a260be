"""The example of a user's own kind of base has the described effect."""

from __future__ import annotations

import runpy
from typing import Literal

import pytest

from app.errors import DescriptionError
from app.robot.bases.kind import BaseKind
from app.robot.description import KINDS, RobotDescription, register_base_kind
from tests.readme import PROJECT


@pytest.fixture(scope="module")
def example():
    known = dict(KINDS)
    yield runpy.run_path(str(PROJECT / "examples" / "custom_base.py"))
    KINDS.clear()
    for kind in known.values():
        register_base_kind(kind)


@pytest.mark.slow
def test_the_carriage_gives_way_along_its_rail_without_contact(example) -> None:
    figures = example["main"](duration=4.0)
    assert figures["min_clearance_m"] > 0.05
    assert figures["contacts"] == 0
    assert figures["base_displacement_m"] > 0.1
    assert figures["base_yaw_rad"] == pytest.approx(0.0, abs=1e-6)


def test_a_registered_kind_is_accepted_in_a_description(example) -> None:
    example["main"](duration=0.01)
    own: type[BaseKind] = example["RailBase"]
    assert KINDS["rail"] is own
    field = RobotDescription.model_fields["base"]
    assert own in field.annotation.__args__


def test_a_second_kind_of_the_same_name_is_refused(example) -> None:
    example["main"](duration=0.01)
    taken = type("Taken", (example["RailBase"],), {"__module__": __name__})
    with pytest.raises(DescriptionError, match="'rail'"):
        register_base_kind(taken)


def test_a_kind_without_required_members_is_refused() -> None:
    class Sledge(BaseKind):
        kind: Literal["sledge"] = "sledge"  # type: ignore[assignment]

    with pytest.raises(DescriptionError, match=r"Sledge must define J_m, axes, .*measure"):
        register_base_kind(Sledge)
    assert "sledge" not in KINDS
