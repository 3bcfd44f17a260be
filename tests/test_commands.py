"""Invalid commands are refused when they are sent, with an error for the sender."""

from __future__ import annotations

import math

import pytest

from app.errors import ConfigError, DbbError, TargetError, UnknownNameError
from app.simulation.loop.commands import (
    Choose,
    Compare,
    Mailbox,
    Play,
    Pull,
    Speed,
    StepOnce,
)
from app.simulation.scenarios import SCENARIOS

NAN = float("nan")


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("refrigerator", {"door_width": 3.0}),
        ("refrigerator", {"base": (0.0, NAN, 0.0)}),
        ("refrigerator", {"hinge_position": (1.0,)}),
        ("refrigerator", {"start": (0.5, 0.0, 0.5)}),
        ("tracking", {"start": (0.5, 0.0)}),
        ("tracking", {"move": (0.5, 0.0, math.inf)}),
        ("tracking", {"mode": "dancing"}),
        ("tracking", {"moving": 0.0}),
        ("tracking", {"duration": 0.0}),
        ("tracking", {"duration": NAN}),
        ("tracking", {"duration": 1e9}),
        ("tracking", {"name": "another"}),
        ("way-out", {"begin": "asleep"}),
    ],
)
def test_unknown_options_and_values_out_of_range_are_refused(name, options):
    with pytest.raises(ConfigError):
        Play(SCENARIOS[name].changed(**options))


@pytest.mark.parametrize(
    ("make", "error"),
    [
        (lambda: Choose("dbbb"), UnknownNameError),
        (lambda: Pull((0.7, 0.0, 0.4), "base_link"), UnknownNameError),
        (lambda: Pull((0.7, 0.0, 0.4), 5), UnknownNameError),
        (lambda: Pull((0.7, 0.0, 0.4), "panda_link4", (2.0, 0.0, 0.0)), TargetError),
        (lambda: Pull((0.7, 0.0, 0.4), "panda_link4", (NAN, 0.0, 0.0)), TargetError),
        (lambda: Pull((0.7, 0.0, 0.4), None, (0.1, 0.0, 0.0)), TargetError),
        (lambda: Compare(("dbb", "none", "barrier")), ConfigError),
        (lambda: Compare(("dbb", "no")), UnknownNameError),
        (lambda: Compare(("dbb",), "time"), UnknownNameError),
        (lambda: Pull((0.7, 0.0, -0.01)), TargetError),
        (lambda: Pull((0.7, NAN, 0.2)), TargetError),
        (lambda: Pull((0.7, 0.2)), TargetError),
        (lambda: Pull(("a", "b", "c")), TargetError),
        (lambda: Pull((1e300, 0.0, 0.5)), TargetError),
        (lambda: Pull("x"), TargetError),
        (lambda: Speed(0.05), ConfigError),
        (lambda: Speed(4.5), ConfigError),
        (lambda: Speed(NAN), ConfigError),
        (lambda: StepOnce(0.0), ConfigError),
        (lambda: StepOnce(60.0), ConfigError),
    ],
)
def test_invalid_command_is_refused_with_an_error_of_the_project(make, error):
    with pytest.raises(error) as caught:
        Mailbox().put(make(), ("panda_link4",))
    assert isinstance(caught.value, DbbError)


@pytest.mark.parametrize(
    "command",
    [Pull((0.5, 0.0, 0.4), "panda_link4"), Choose("none"), Speed(4), StepOnce()],
)
def test_valid_command_is_accepted(command):
    Mailbox().put(command, ("panda_link4",))
