"""One configuration for all clients: changes, errors, undo, marks, saving and loading."""

from __future__ import annotations

import asyncio
import contextlib
import math
from inspect import iscoroutine, iscoroutinefunction
from itertools import pairwise
from types import SimpleNamespace

import pytest
import viser
from hypothesis import given
from hypothesis import strategies as st

from app.config import Config, parameter, sections, tunable, tunables
from app.config_file import MAX_BYTES, decode_config, save_config
from app.dashboard.notifications import Notifier
from app.dashboard.panels.tuning import (
    MARK,
    TuningPanel,
    file_name,
    slider_step,
    unbroken,
)
from app.dashboard.shared import BURST, MOST_STEPS, Tuning
from app.errors import ConfigError
from app.simulation.loop.commands import Configure
from tests.robots import husky_panda

TUNABLES = {each.path: each for section in sections() for each in section.tunables}
NUMBERS = [path for path, each in TUNABLES.items() if not each.choices]
D_B = "border.d_b"


class Clock:
    """A clock that a test sets."""

    now = 100.0

    def __call__(self) -> float:
        return self.now


class Person:
    """A client that records the messages and files that it receives."""

    client_id = 1

    def __init__(self):
        self.notes, self.files, self.messages = [], [], []
        self._websock_connection = SimpleNamespace(queue_message=self.messages.append)

    def add_notification(self, title, text, **_):
        self.notes.append(text)
        return SimpleNamespace(remove=lambda: None)

    def send_file_download(self, name, content, **_):
        self.files.append((name, content))


class Sink:
    """Records commands."""

    def __init__(self):
        self.commands = []

    def send(self, command):
        self.commands.append(command)


class Desk:
    """A configuration and the panels of two clients."""

    def __init__(self, servers):
        self.sink, self.clock = Sink(), Clock()
        self.tuning = Tuning(self.sink, Config(), Config(), clock=self.clock)
        self.viewers = [self.viewer(server) for server in servers]
        self.panels = [TuningPanel(viewer) for viewer in self.viewers]
        self.newest = SimpleNamespace(changing="", paused=False)

    def viewer(self, server):
        """A client with its own server."""
        shared = SimpleNamespace(tuning=self.tuning, model=husky_panda())
        return SimpleNamespace(client=server, notifier=Notifier(server), shared=shared, panels=[])

    def handle(self, path, viewer=0):
        return self.panels[viewer].widgets[path].handle

    def sees(self, path, viewer=0):
        return self.handle(path, viewer).value

    def update(self):
        for panel in (panel for viewer in self.viewers for panel in viewer.panels):
            panel.update(SimpleNamespace(newest=self.newest))


@pytest.fixture(scope="module")
def servers():
    servers = [viser.ViserServer(host="127.0.0.1", port=0, verbose=False) for _ in range(2)]
    yield servers
    for server in servers:
        server.stop()


@pytest.fixture
def desk(servers):
    for server in servers:
        server.gui.reset()
    return Desk(servers)


def put(handle, value, person):
    """Viser's reaction to a client's value: store it and call the callbacks."""
    handle._impl.value = value
    event = SimpleNamespace(client=person, client_id=1, target=handle)
    for callback in list(handle._impl.update_cb):
        if iscoroutine(begun := callback(event)):  # viser calls other functions in a thread
            asyncio.run(begun)


def press(gui, label, value=True, person=None):
    """Press the newest button or upload with a label, or one button of a group."""
    found = [h for h in gui._gui_input_handle_from_uuid.values() if h.label == label]
    person = person or Person()
    put(found[-1], value, person)
    return person


# The history


def test_each_change_is_sent_once():
    sink = Sink()
    tuning = Tuning(sink, Config(), Config())
    for _ in range(2):
        tuning.set(D_B, 0.2)
    assert sink.commands == [Configure(Config().replace(D_B, 0.2))]


@pytest.mark.parametrize("value", [99999.0, -1.0, math.nan, math.inf, "0.2", [0.2], None, True])
def test_rejected_value_changes_nothing_and_adds_no_undo_step(value):
    sink = Sink()
    tuning = Tuning(sink, Config(), Config())
    with pytest.raises(ConfigError, match=r"border\.d_b: must be within 0\.05 to 0\.3 m"):
        tuning.set(D_B, value)
    with pytest.raises(ConfigError, match="nothing to undo"):
        tuning.undo()
    assert (tuning.config, sink.commands) == (Config(), [])


def test_changes_of_one_slider_within_the_burst_are_one_step():
    clock = Clock()
    tuning = Tuning(Sink(), Config(), Config(), clock=clock)
    for value in (0.16, 0.17, 0.18):
        clock.now += 0.99 * BURST
        tuning.set(D_B, value)
    clock.now += 1.01 * BURST
    tuning.set(D_B, 0.19)
    tuning.set("force.f_max", 200.0)
    tuning.set(D_B, 0.20)
    seen = []
    for _ in range(4):
        tuning.undo()
        seen.append((tuning.config.value(D_B), tuning.config.value("force.f_max")))
    assert seen == [(0.19, 200.0), (0.19, 300.0), (0.18, 300.0), (0.15, 300.0)]
    with pytest.raises(ConfigError, match="nothing to undo"):
        tuning.undo()


def test_change_and_return_within_one_burst_is_no_step():
    tuning = Tuning(Sink(), Config(), Config(), clock=Clock())
    tuning.set("force.f_max", 200.0)
    tuning.set(D_B, 0.2)
    tuning.set(D_B, 0.15)
    tuning.undo()
    assert tuning.config == Config()


acts = st.one_of(
    st.tuples(st.just("set"), st.sampled_from(NUMBERS), st.floats(0, 1), st.floats(0, 2)),
    st.sampled_from([("undo",), ("redo",), ("reset",)]),
)


@given(st.lists(acts, max_size=15))
def test_undo_of_all_steps_and_redo_visit_the_same_configurations(script):
    clock, sink = Clock(), Sink()
    tuning = Tuning(sink, Config(), Config(), clock=clock)
    for name, *given_ in script:
        before = tuning.config
        try:
            if name == "set":
                path, share, wait = given_
                clock.now += wait
                about = parameter(path)
                tuning.set(path, min(about.low + share * (about.high - about.low), about.high))
            else:
                getattr(tuning, name)()
        except ConfigError:
            assert tuning.config is before
    until_refused(tuning, tuning.redo)
    back = until_refused(tuning, tuning.undo)
    assert back[-1] == Config()
    assert until_refused(tuning, tuning.redo) == back[::-1]
    assert all(a != b for a, b in pairwise(back)), "each step must change the configuration"
    assert not sink.commands or sink.commands[-1] == Configure(tuning.config)


def until_refused(tuning, act):
    """The configurations from now on, until no further undo or redo is possible."""
    seen = [tuning.config]
    with contextlib.suppress(ConfigError):
        for _ in range(1000):
            act()
            seen.append(tuning.config)
    assert len(seen) <= 1000
    return seen


def test_change_after_undo_discards_the_redo_steps():
    tuning = Tuning(Sink(), Config(), Config(), clock=Clock())
    tuning.set(D_B, 0.2)
    tuning.undo()
    tuning.set(D_B, 0.25)
    with pytest.raises(ConfigError, match="nothing to redo"):
        tuning.redo()
    assert tuning.config.value(D_B) == 0.25


def test_a_gain_too_large_for_the_stated_period_is_refused_and_not_stored():
    tuning = Tuning(sink := Sink(), Config(), Config(), clock=Clock())
    tuning.set("repulsion.k_v", 100.0)
    with pytest.raises(ConfigError, match="too large for a control period of 8 ms"):
        tuning.set("disturbance.stated_period", 0.008)
    with pytest.raises(ConfigError, match="too large for a control period of 8 ms"):
        tuning.load(tuning.config.replace("disturbance.stated_period", 0.008))
    assert tuning.config == Config().replace("repulsion.k_v", 100.0)
    tuning.set(D_B, 0.2)
    assert len(sink.commands) == 2


def test_history_is_bounded():
    clock = Clock()
    tuning = Tuning(Sink(), Config(), Config(), clock=clock)
    for i in range(MOST_STEPS + 50):
        clock.now += 2 * BURST
        tuning.set("force.f_max", float(i))
    for _ in range(MOST_STEPS):
        tuning.undo()
    assert tuning.config.value("force.f_max") == 49.0
    with pytest.raises(ConfigError):
        tuning.undo()


def test_load_and_reset_are_one_step_each():
    tuning = Tuning(Sink(), Config(), Config(), clock=Clock())
    loaded = Config().replace(D_B, 0.2).replace("hand.f_max", 20.0)
    tuning.load(loaded)
    tuning.reset([D_B])
    assert tuning.config == Config().replace("hand.f_max", 20.0)
    tuning.reset()
    assert tuning.config == Config()
    tuning.reset()  # changes nothing, so it adds no step
    tuning.undo()
    tuning.undo()
    assert tuning.config == loaded
    tuning.undo()
    assert tuning.config == Config()


def test_defaults_are_those_of_the_robot():
    tuning = Tuning(Sink(), Config(), Config().replace(D_B, 0.1), clock=Clock())
    assert tuning.changes == {D_B: 0.15}
    tuning.reset([D_B])
    assert tuning.config == tuning.usual
    tuning.set("hand.f_max", 20.0)
    assert tuning.changes == {"hand.f_max": 20.0}
    tuning.reset()
    assert tuning.config == tuning.usual


# The widgets


def test_every_parameter_has_a_widget_with_range_unit_value_and_help(desk):
    assert list(desk.panels[0].widgets) == list(TUNABLES)
    for path, about in TUNABLES.items():
        handle = desk.handle(path)
        assert handle.value == about.default, path
        assert handle.hint.startswith(about.help), path
        if about.choices:
            assert (handle.options, handle.label) == (about.choices, about.title)
        else:
            assert (handle.min, handle.max) == (about.low, about.high), path
            assert handle.precision == 6, path
            assert handle.label.replace("\N{NO-BREAK SPACE}", " ") == about.title, path


def test_every_label_names_its_quantity_before_the_symbol():
    for path, about in tunables().items():
        first = about.label.split()[0]
        assert first[0].isupper(), path
        assert len(first) >= 3, path
        assert not about.label.endswith("]"), path


def test_every_default_is_on_a_step_of_its_slider():
    for path in NUMBERS:
        about = parameter(path)
        step = slider_step(about.low, about.high)
        assert 100 <= (about.high - about.low) / step <= 1000.0001, path
        if not about.log:
            assert math.isclose(about.default / step, round(about.default / step)), path


@pytest.mark.parametrize("path", list(TUNABLES))
def test_each_widget_changes_only_its_parameter(desk, path):
    about = TUNABLES[path]
    value = about.choices[-1] if about.choices else about.high
    if value == about.default:
        value = value if about.choices else about.low
    put(desk.handle(path), value, Person())
    assert desk.sink.commands == [Configure(Config().replace(path, value))]


def test_change_appears_at_all_clients_without_echo(desk):
    put(desk.handle(D_B), 0.2, Person())
    assert desk.sees(D_B, viewer=1) == 0.15
    for _ in range(3):
        desk.update()
    assert desk.sees(D_B, viewer=0) == desk.sees(D_B, viewer=1) == 0.2
    desk.tuning.undo()
    desk.update()
    assert desk.sees(D_B, viewer=0) == desk.sees(D_B, viewer=1) == 0.15
    assert [c.config.border.d_b for c in desk.sink.commands] == [0.2, 0.15]


def test_assignment_by_the_program_sends_nothing(desk):
    handle = desk.handle(D_B)
    put(handle, 0.2, None)  # as viser reports an assignment
    assert desk.sink.commands == []


@pytest.mark.parametrize("value", [9e9, -1.0, math.nan, math.inf])
@pytest.mark.parametrize("path", [D_B, "task.base_weight"])
def test_rejected_value_is_reset_in_the_widget(desk, path, value):
    sender = Person()
    put(desk.handle(path), value, sender)
    for _ in range(3):
        desk.update()
    assert desk.handle(path).value == tunable(path).default


def test_logarithmic_slider_and_its_number_show_the_same_value(desk):
    for path in (path for path in NUMBERS if parameter(path).log):
        widget = desk.panels[0].widgets[path]
        put(widget.exponent, math.log10(parameter(path).high) - 0.5, Person())
        value = desk.tuning.config.value(path)
        assert math.log10(value) == pytest.approx(math.log10(parameter(path).high) - 0.5, abs=0.005)
        desk.update()
        assert widget.handle.value == value
        desk.tuning.set(path, parameter(path).low)
        desk.update()
        assert widget.exponent.value == pytest.approx(math.log10(parameter(path).low), abs=0.006)


@pytest.mark.parametrize("power", [1e9, -1e9, math.inf, math.nan])
def test_exponent_out_of_range_is_rejected(desk, power):
    path = next(path for path in NUMBERS if parameter(path).log)
    before, sender = desk.tuning.config.value(path), Person()
    slider = desk.panels[0].widgets[path].exponent
    put(slider, power, sender)
    assert desk.tuning.config.value(path) == before
    assert slider.value == pytest.approx(math.log10(before), abs=0.006)
    assert len(sender.notes) == 1
    assert parameter(path).allowed in sender.notes[0]
    assert (desk.tuning.config, desk.sink.commands) == (Config(), [])


def test_unknown_choice_is_rejected(desk):
    sender = Person()
    put(desk.handle("border.kind"), "cloud", sender)
    assert desk.sees("border.kind") == "surface"
    assert "surface or points" in sender.notes[0]


def test_changed_parameter_is_marked_on_label_and_folder(desk):
    def labels():
        return {
            h.label
            for h in desk.panels[0]._gui._container_handle_from_uuid.values()
            if isinstance(h, viser.GuiFolderHandle)
        }

    assert "Force" in labels()
    put(desk.handle("force.f_max"), 200.0, Person())
    put(desk.handle("force.alpha_min"), 0.05, Person())
    desk.update()
    assert desk.handle("force.f_max").label == unbroken("Force at contact f_max [N]") + MARK
    assert MARK not in desk.handle("force.alpha_max").label
    assert "Force · 2 changed" in labels()
    press(desk.panels[0]._gui, "Changes", "Reset all")
    desk.update()
    assert "Force" in labels()
    assert MARK not in desk.handle("force.f_max").label
    assert desk.tuning.config == Config()


def test_undo_and_redo_buttons_report_when_nothing_is_left(desk):
    gui = desk.panels[0]._gui
    put(desk.handle(D_B), 0.2, Person())
    press(gui, "Changes", "Undo")
    assert desk.tuning.config.value(D_B) == 0.15
    press(gui, "Changes", "Redo")
    assert desk.tuning.config.value(D_B) == 0.2
    assert "Nothing to redo" in press(gui, "Changes", "Redo").notes[0]
    assert desk.tuning.config.value(D_B) == 0.2


def test_reset_of_all_reports_when_all_parameters_have_their_defaults(desk):
    gui = desk.panels[0]._gui
    assert "Nothing to reset" in press(gui, "Changes", "Reset all").notes[0]
    put(desk.handle(D_B), 0.2, Person())
    assert press(gui, "Changes", "Reset all").notes == []
    assert desk.tuning.config == Config()


def test_a_note_explains_a_slow_change_and_that_it_waits_during_a_pause(desk):
    note = desk.panels[1].changing
    desk.update()
    assert note.content == ""
    desk.newest.changing = "Buffer d_b: 0.150 m, changing to 0.250 m"
    desk.update()
    assert desk.newest.changing in note.content
    assert "slowly" in note.content
    desk.newest.paused = True
    desk.update()
    assert desk.newest.changing in note.content
    assert "paused" in note.content


def test_defaults_of_one_folder_do_not_reset_the_others(servers):
    servers[0].gui.reset()
    desk = Desk(servers[:1])
    desk.tuning.set(D_B, 0.2)
    last = desk.panels[0]._folders[-1][-1][0]
    desk.tuning.set(last, TUNABLES[last].high)
    press(servers[0].gui, "Defaults")
    assert desk.tuning.config == Config().replace(D_B, 0.2)
    desk.tuning.reset()
    desk.tuning.set(D_B, 0.2)
    desk.tuning.reset([D_B])
    desk.tuning.undo()
    assert desk.tuning.config.value(D_B) == 0.2


def test_advanced_parameters_are_shown_on_request_or_if_changed(desk):
    advanced = [path for path, about in TUNABLES.items() if about.advanced]
    assert advanced

    def shown():
        return [path for path in advanced if desk.handle(path).visible]

    assert shown() == []
    assert all(desk.handle(p).visible for p, about in TUNABLES.items() if not about.advanced)
    desk.tuning.set("force.alpha_gain", 0.01)
    desk.update()
    assert shown() == ["force.alpha_gain"]
    press(desk.panels[0]._gui, "Advanced")
    assert shown() == advanced


# Files


def upload(desk, content, name="mine.toml"):
    file = viser.UploadedFile(name=name, content=content)
    return press(desk.panels[0]._gui, "Load", file)


def test_saved_configuration_loads_in_one_step(desk):
    gui = desk.panels[0]._gui
    desk.tuning.load(config := Config().replace(D_B, 0.2).replace("border.kind", "points"))
    press(gui, "Name", " stiff/arm ")
    [(name, content)] = press(gui, "Save").files
    assert name == "stiff-arm.toml"
    assert decode_config(content) == ("stiff/arm", config, ())
    desk.tuning.reset()
    assert upload(desk, content).notes == ["mine.toml: 2 changed from the defaults."]
    assert desk.tuning.config == config
    desk.tuning.undo()
    assert desk.tuning.config == Config()


def test_file_is_read_outside_the_receiving_thread(desk):
    """Viser awaits `async` callbacks in the thread that receives the messages of all clients."""
    handles = desk.panels[0]._gui._gui_input_handle_from_uuid.values()
    (load,) = [handle for handle in handles if handle.label == "Load"]
    assert [iscoroutinefunction(each) for each in load._impl.update_cb] == [False]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"#" * (MAX_BYTES + 1), "at most 64000"),
        (b"\xff\xff", "UTF-8"),
        (b"[border]\nd_b = 1", "border.d_b: must be within 0.05 to 0.3 m"),
        (b"[border]\nd_bb = 1", "did you mean 'd_b'"),
    ],
)
def test_invalid_file_error_has_name_and_problem(desk, content, message):
    [note] = upload(desk, content).notes
    assert note.startswith("mine.toml: ")
    assert message in note
    assert (desk.tuning.config, desk.sink.commands) == (Config(), [])


def test_unprintable_name_is_rejected(desk):
    gui = desk.panels[0]._gui
    press(gui, "Name", "a\nb")
    person = press(gui, "Save")
    assert person.files == []
    assert "printable" in person.notes[0]


@pytest.mark.parametrize(
    ("name", "file"),
    [("a b", "a b.toml"), ("../x", "-x.toml"), ("", "tuning.toml"), ("é☃?", "é--.toml")],
)
def test_file_name_is_valid_on_any_system(name, file):
    assert file_name(name) == file


def test_loaded_file_appears_in_all_widgets(desk):
    upload(desk, save_config(Config().replace("hand.f_max", 20.0)).encode())
    desk.update()
    assert desk.sees("hand.f_max", viewer=1) == 20.0
