"""Commands on their way from many viewers to the simulation."""

from __future__ import annotations

import time

import pytest

from app.config import Config
from app.dashboard.outbox import PERIOD, Outbox
from app.errors import DbbError
from app.simulation.snapshot import Choose, Configure, Pause, Pull


class Recorder:
    def __init__(self):
        self.commands = []

    def send(self, command):
        self.commands.append(command)


def configure(d_b):
    return Configure(Config().replace("border.d_b", d_b))


def test_a_flood_goes_on_as_its_newest_only():
    loop = Recorder()
    outbox = Outbox(loop)
    begin = time.monotonic()
    for k in range(10_000):
        outbox.send(configure(0.1 + 1e-5 * k))
    most = (time.monotonic() - begin) / PERIOD + 1
    outbox.flush()
    assert len(loop.commands) <= most + 1
    assert loop.commands[-1] == configure(0.1 + 1e-5 * 9999)


def test_what_comes_alone_goes_at_once():
    loop = Recorder()
    outbox = Outbox(loop)
    for command in (configure(0.2), Pull((0.5, 0.0, 0.5)), Pause(True)):
        outbox.send(command)
        assert loop.commands[-1] == command


def test_letting_go_is_never_held_and_comes_after_the_pull():
    loop = Recorder()
    outbox = Outbox(loop)
    for z in (0.5, 0.6, 0.7):
        outbox.send(Pull((0.5, 0.0, z)))
    outbox.send(Pull(None))
    assert loop.commands == [Pull((0.5, 0.0, 0.5)), Pull((0.5, 0.0, 0.7)), Pull(None)]


@pytest.mark.parametrize("command", [Pull((0.0, 0.0, float("nan"))), Choose("nonsense")])
def test_what_can_never_be_obeyed_is_the_senders_error(command):
    loop = Recorder()
    with pytest.raises(DbbError):
        Outbox(loop).send(command)
    assert loop.commands == []
