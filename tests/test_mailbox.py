"""Of any number of commands only a few wait, with the same result."""

from __future__ import annotations

import numpy as np
import pytest

from app.config import Config
from app.errors import LoopError
from app.simulation.loop.commands import (
    MAX_WAITING,
    Choose,
    Configure,
    Mailbox,
    Pause,
    Play,
    Pull,
    Release,
    Reset,
    Restart,
    Speed,
    StepOnce,
    Watch,
)
from app.simulation.scenarios import SCENARIOS

LATERAL = Play(SCENARIOS["guiding-lateral"])


def after(*commands) -> list:
    mailbox = Mailbox()
    for command in commands:
        mailbox.put(command, ("panda_link4",))
    return mailbox.take()


def pull(x: float) -> Pull:
    return Pull((x, 0.0, 0.5))


def test_only_the_newest_of_many_commands_of_a_kind_waits():
    rng = np.random.default_rng(0)
    configs = [Config().replace("border.d_b", d) for d in (0.10, 0.15, 0.20)]
    kinds = (
        lambda k: pull(k * 1e-4),
        lambda k: Configure(configs[k % 3]),
        lambda k: Pause(k % 2 == 0),
        lambda k: Choose(("dbb", "none")[k % 2]),
        lambda k: Speed(0.5 + k * 1e-5),
        lambda k: Reset(),
        lambda k: StepOnce(),
    )
    sent = [kinds[i](k) for k, i in enumerate(rng.integers(len(kinds), size=10_000))]
    left = after(*sent)
    assert len(left) == len(kinds) < MAX_WAITING
    for command in left:
        assert command == [other for other in sent if type(other) is type(command)][-1]


def test_taking_preserves_the_order_and_empties_the_mailbox():
    mailbox = Mailbox()
    for command in (LATERAL, pull(0.4), Pause(True)):
        mailbox.put(command, ("panda_link4",))
    assert mailbox.take() == [LATERAL, pull(0.4), Pause(True)]
    assert mailbox.take() == []


def test_a_later_pull_stays_after_a_scenario_and_a_release_replaces_pulls():
    assert after(pull(0.4), LATERAL, pull(0.5)) == [LATERAL, pull(0.5)]
    assert after(pull(0.4), LATERAL) == [pull(0.4), LATERAL]
    assert after(pull(0.4), pull(0.5), Release(0)) == [Release(0)]


def test_a_scenario_starts_with_the_newest_parameters():
    old, new = Config(), Config().replace("border.d_b", 0.2)
    assert after(Configure(old), LATERAL, Configure(new)) == [Configure(new), LATERAL]


def test_only_the_last_of_several_starts_waits():
    assert after(LATERAL, Reset()) == [Reset()]
    assert after(Reset(), LATERAL) == [LATERAL]
    assert after(LATERAL, Restart()) == [LATERAL]  # the scenario starts anyway
    assert after(Restart()) == [Restart()]


def test_each_persons_pull_waits_separately_up_to_a_limit():
    two = pull(0.4), Pull((0.3, 0.0, 0.5), "panda_link4", who=2)
    assert after(*two) == list(two)
    assert after(*two, Release(0)) == [two[1], Release(0)]
    with pytest.raises(LoopError, match="64 commands already wait"):
        after(*(Pull((0.3, 0.0, 0.5), who=who) for who in range(MAX_WAITING + 1)))


def test_other_commands_than_pulls_always_wait():
    full = [Pull((0.3, 0.0, 0.5), who=who) for who in range(MAX_WAITING)]
    others = [Watch(False), Pause(True), Reset(), Release(MAX_WAITING), Choose("dbb")]
    assert after(*full, *others) == [*full, *others]
