"""The explanation in words agrees with the numbers, for every controller and every state."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from itertools import product

import pytest
import viser
from hypothesis import given
from hypothesis import strategies as st

from app.control.controller import CONTROLLERS
from app.control.explanation import Bound, Explanation, ForceSplit, Level, NearPair
from app.dashboard import phrases as words
from app.dashboard.panels import why as why_panel
from app.dashboard.panels.why import sentence
from app.dashboard.verdict import judge
from app.robot.bases.kind import FORWARD, TURN, Planar
from app.simulation.trace.snapshot import Snapshot
from tests.fakes import ScriptedLoop
from tests.robots import husky_panda

CHAIN = ("lm", "l1", "l2", "l3", "lEE")
UNITS = {"forward": (1, 0), "backward": (-1, 0), "left": (0, 1), "right": (0, -1)}
FRONT, LEFT, REAR, TOP = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
CORNER = (0.8, -0.6, 0.0)
LONGEST = 280  # [characters] a longer sentence would move the rows below it
FORCE = ForceSplit((-80, -60), (-80, 0), (0, -60), (-0.4, 0), (0, -0.2), 2.3e-4, 98, 0.022, 0.021)
BASE = NearPair("lm", "lEE", True, 0.08, 0.7, FRONT, 0.0, 0.0, False, FORCE)
LINKS = NearPair("l1", "lEE", False, 0.09, 0.5, FRONT, 0.0, 0.0, False, None)
ABOVE = BASE._replace(d=0.06, n=TOP, above=1.0, limited=True)
LAST = BASE._replace(d=0.05, limited=True)
INSIDE = BASE._replace(d=-0.004, beta=1.0, limited=True)
HELD = BASE._replace(d=0.05, limited=True, force=None)
NEAR = {
    "nothing": (),
    "base": (BASE,),
    "left": (BASE._replace(n=LEFT),),
    "corner": (BASE._replace(n=CORNER, d=0.123), LINKS),
    "rear": (BASE._replace(n=REAR),),
    "above": (ABOVE,),
    "high above": (ABOVE._replace(limited=False, d=0.13),),
    "last": (LAST,),
    "inside": (INSIDE,),
    "links": (LINKS,),
    "both": (BASE, LINKS),
    "held": (HELD, LINKS),
    "edge": (BASE._replace(d=0.148),),
    "all": (ABOVE, BASE._replace(b="l3"), LINKS),
}
MOTIONS = {"rest": (0.0, 0.0), "back": (-0.21, 0.3), "turns": (0.0, -0.5), "ahead": (0.4, 0.0)}
BOUNDS = (
    (),
    (Bound("panda_joint4", "torque", upper=True),),
    tuple(Bound(f"panda_joint{i}", "angular acceleration", upper=True) for i in range(1, 8)),
)
LEVELS = (
    Level("base", 0.0, 0.31),
    Level("arm", 0.0, None),
    Level("links", 12.0, None),
    Level("ee", 92.9, 4.2),
    Level("posture", None, 0.6),
)


@pytest.fixture(scope="module")
def blank() -> Snapshot:
    return ScriptedLoop(husky_panda()).latest()


def explanation(near: tuple[NearPair, ...] = (), **fields: object) -> Explanation:
    why = Explanation(
        controller="dbb",
        mode="guiding",
        solved=True,
        chain=CHAIN,
        near=near,
        nearest=("lm", "lEE", near[0].d if near else 0.23),
        axes=(FORWARD, TURN),
        base_avoidance=(0.0, 0.0),
        commanded_acceleration=(0.0, 0.0),
        assumed_acceleration=(0.0, 0.0),
        levels=(),
        bounds=(),
    )
    return why._replace(**fields)


def why_html(snapshot: Snapshot) -> str:
    return why_panel.why_html(snapshot, judge(snapshot)) + why_panel.details_html(snapshot)


def sentence_for(blank: Snapshot, why: Explanation, **fields: object) -> str:
    return sentence(replace(blank, explanation=why, controller=why.controller, **fields))


def vector(text: str) -> tuple[float, float]:
    x, y = (sum(UNITS[word][i] for word in text.split()) for i in (0, 1))
    return x / math.hypot(x, y), y / math.hypot(x, y)


# Numbers as words


@given(st.floats(-math.pi, math.pi), st.floats(0.1, 600))
def test_direction_in_words_is_within_half_a_sector_of_the_force(heading, size):
    x, y = size * math.cos(heading), size * math.sin(heading)
    word = vector(words.direction(x, y))
    assert word[0] * x + word[1] * y >= size * math.cos(math.pi / 8) * (1 - 1e-9)


@given(st.floats(-math.pi, math.pi), st.floats(0.1, 600))
def test_angle_in_degrees_agrees_with_the_force(heading, size):
    text = words.angle(size * math.cos(heading), size * math.sin(heading))
    degrees = float(text.split("°")[0]) * (-1.0 if "right" in text else 1.0)
    assert math.cos(math.radians(degrees) - heading) >= math.cos(math.radians(0.51))
    assert ("left" in text or "right" in text) == (degrees not in (0.0, 180.0))


@given(st.floats(-math.pi, math.pi), st.floats(-0.79, 0.79))
def test_named_side_of_the_base_agrees_with_the_normal(heading, n_z):
    flat = math.sqrt(1 - n_z**2)
    text = words.place((flat * math.cos(heading), flat * math.sin(heading), n_z))
    named = [{"front": "forward", "rear": "backward"}.get(word, word) for word in text.split()]
    word = vector(" ".join(w for w in named if w in UNITS))
    assert word[0] * math.cos(heading) + word[1] * math.sin(heading) >= math.cos(math.pi / 8) - 1e-9


def test_nearly_vertical_normal_is_named_top():
    assert words.place((0.3, 0.0, 0.95)) == words.place(TOP) == "top"


@given(st.floats(-2, 2), st.floats(-2, 2), st.booleans())
def test_motion_in_words_has_the_signs_of_the_velocity(v, w, ahead):
    for text, least in (
        (words.motion(Planar(v, 0.0, w), ahead=ahead), words.AT_REST),
        (words.motion(Planar(v, 0.0, w), ahead=ahead, intended=True), words.SLIGHT),
    ):
        assert (text is None) == (abs(v) < least[0] and abs(w) < least[1])
        phrase = text or ""
        assert ("back" in phrase) == (v <= -least[0])
        assert ("forward" in phrase) == (v >= least[0])
        assert ("left" in phrase) == (w >= least[1])
        assert ("right" in phrase) == (w <= -least[1])


@given(st.floats(-1e3, 1e3))
def test_number_in_scientific_notation_can_be_read_back(value):
    digits = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹−", "-0123456789-")
    mantissa, _, power = words.scientific(value).partition("·10")
    read = float(mantissa.translate(digits)) * 10.0 ** int(power.translate(digits) or 0)
    assert read == pytest.approx(value, rel=0.051)


def test_bodies_are_named_from_the_end_effector_inwards():
    names = [words.body(name, CHAIN) for name in CHAIN]
    assert names == ["base", "shoulder", "upper arm", "forearm", "end-effector"]
    assert words.body("lEE", (*CHAIN, "door")) == "end-effector"
    assert words.body("door", (*CHAIN, "door")) == "door"
    assert words.body("l1", ("lm", "l1", "l2", "l3", "l4", "lEE")) == "link l1"


def test_a_limit_names_the_joint_or_the_pair():
    assert words.bound(BOUNDS[1][0], CHAIN) == "panda_joint4: torque limit"
    assert words.bound(Bound("lm-lEE", "barrier", upper=False), CHAIN).startswith(
        "end-effector – base: "
    )


# The sentence


EVERYTHING = list(
    product(CONTROLLERS, NEAR, MOTIONS, ("guiding", "tracking"), (LEVELS, ()), (True, False))
)


@pytest.mark.parametrize("controller", CONTROLLERS)
def test_every_state_has_one_short_sentence(blank, controller):
    for name, near, moves, mode, levels, solved in EVERYTHING:
        if name != controller:
            continue
        why = explanation(
            NEAR[near],
            controller=name,
            mode=mode,
            levels=levels,
            solved=solved,
            bounds=(Bound("base", "speed", upper=True),),
        )
        for contact in product((False, True), repeat=3):
            text = sentence_for(
                blank,
                why,
                base_velocity=MOTIONS[moves],
                in_contact=contact[0],
                arm_in_contact=contact[1],
                floor_contact=contact[2],
                ee_error=0.123,
            )
            assert len(text) <= LONGEST, text
            assert re.fullmatch(r"[A-Z].*\.", text), text
            assert not re.search(r"None|nan|\(\)|  |lm|lEE|l1", text), text
            assert any(contact) == bool(re.search(r" touch( \(\+\d\))?\. ", text))


def test_sentence_states_distance_buffer_side_and_motion_of_the_base(blank):
    why = explanation(NEAR["base"], mode="tracking")
    assert sentence_for(blank, why, base_velocity=(-0.21, 0.3)) == (
        "The end-effector is 80 mm from the base's front (buffer 150 mm), so the base backs away "
        "at 0.21 m/s and turns left; the end-effector's task is not affected."
    )


def test_sentence_announces_the_motion_of_a_base_at_rest(blank):
    why = explanation(NEAR["base"], commanded_acceleration=(-0.3, -0.2))
    assert "about to back away and turn right" in sentence_for(blank, why, base_velocity=(0.0, 0.0))
    idle = explanation(NEAR["base"])
    assert "the base stays where it is" in sentence_for(blank, idle, base_velocity=(0.0, 0.0))


@pytest.mark.parametrize("held", [False, True])
@pytest.mark.parametrize("near", ["base", "above", "inside"])
def test_sentence_mentions_the_arms_limit_if_and_only_if_it_is_active(blank, near, held):
    (pair,) = NEAR[near]
    text = sentence_for(blank, explanation((pair._replace(limited=held),)))
    assert ("the arm itself limits the approach" in text) == held


@pytest.mark.parametrize(("slack", "disturbed"), [(0.0, False), (0.04, False), (3.0, True)])
def test_sentence_calls_the_task_reduced_only_with_much_slack(blank, slack, disturbed):
    why = explanation(NEAR["base"], mode="tracking", levels=(Level("ee", slack, 0.0),))
    assert ("task is reduced" in sentence_for(blank, why)) == disturbed
    assert ("not affected" in sentence_for(blank, why)) != disturbed


@pytest.mark.parametrize(
    ("near", "controller", "part"),
    [
        ("nothing", "dbb", "Nothing is inside the buffer: the "),
        ("nothing", "none", "Avoidance is off."),
        ("base", "none", "avoidance is off: nothing gives way"),
        ("above", "dbb", "base's top (buffer 150 mm), where base motion cannot help"),
        ("high above", "dbb", "the arm itself comes no nearer than 31 mm"),
        ("high above", "hqp", "the paper's hierarchy has no other constraint on the arm"),
        ("last", "dbb", "and the arm itself limits the approach."),
        ("inside", "dbb", "The end-effector overlaps the base's front by 4 mm"),
        ("edge", "dbb", "The end-effector is 148 mm from the base's front (buffer 150 mm)"),
        ("links", "dbb", "is 90 mm from the shoulder (buffer 150 mm), so the arm pushes"),
        ("both", "dbb", "End-effector and shoulder are also pushed apart."),
        ("base", "repulsive", "pushes the arm away and does not move the base"),
        ("held", "barrier", "the minimum distance of 31 mm limits the approach"),
        ("base", "barrier", "this method acts only near its minimum distance of 31 mm"),
    ],
)
def test_sentence_gives_the_reason_for_each_state(blank, near, controller, part):
    assert part in sentence_for(blank, explanation(NEAR[near], controller=controller))


@pytest.mark.parametrize("controller", CONTROLLERS)
def test_verdict_names_the_behaviour_of_each_controller(blank, controller):
    pair = blank.pairs[0]._replace(d=0.10, beta=0.5)
    moving = replace(blank, pairs=(pair,), controller=controller, base_velocity=(-0.2, 0.0))
    state = {"dbb": "giving way", "hqp": "giving way", "repulsive": "resisting"}
    assert judge(moving).state == state.get(controller, "near")


def test_sentence_reports_a_failed_solver_first(blank):
    text = sentence_for(blank, explanation(NEAR["base"], solved=False))
    assert text.startswith("Fallback command")


def test_sentence_names_the_overlapping_pair_of_several(blank):
    deep = LINKS._replace(d=-0.003, beta=1.0)
    assert "overlaps the shoulder by 3 mm" in sentence_for(blank, explanation((BASE, deep)))


def test_sentence_states_the_buffer_in_force(blank):
    assert "buffer 220 mm" in sentence_for(blank, explanation(NEAR["base"]), d_b=0.22)


def test_sentence_mentions_the_speed_limit_only_if_it_is_active(blank):
    slow, fast = (
        sentence_for(blank, explanation(NEAR["base"], bounds=bounds), base_velocity=(-0.5, 0.0))
        for bounds in ((), (Bound("base", "speed", upper=False),))
    )
    assert ("at its speed limit" in slow, "at its speed limit" in fast) == (False, True)


# The panel


def test_details_are_empty_or_have_a_fixed_number_of_rows(blank):
    rows = {
        near: {
            why_panel.details_html(
                replace(blank, explanation=explanation(NEAR[near], bounds=bounds, levels=levels))
            ).count("<tr")
            for bounds in BOUNDS
            for levels in (LEVELS, LEVELS[3:], ())
        }
        for near in NEAR
    }
    assert rows.pop("nothing") == {0}
    assert len(set.union(*rows.values())) == 1


def test_sentence_without_a_near_pair_states_the_least_distance(blank):
    """Pairs between links of the arm count too."""
    for k, pair in enumerate(blank.pairs):
        pairs = [each._replace(d=0.2 if i == k else 0.4) for i, each in enumerate(blank.pairs)]
        snapshot = replace(blank, pairs=tuple(pairs))
        assert snapshot.nearest.name == pair.name
        text = sentence_for(snapshot, explanation())
        a, b = (words.body(name, CHAIN) for name in pair.name.split("-"))
        assert f"the {b} is 200 mm from the {a}" in text
        spoken = {each.name: words.spoken(each.name, CHAIN) for each in pairs}
        assert f"{spoken[pair.name]} <b>200 mm" in why_panel.header_html(
            replace(snapshot, explanation=explanation()), judge(snapshot), spoken
        )


def test_panel_shows_the_numbers_of_the_explanation(blank):
    why = explanation(
        NEAR["base"],
        base_avoidance=(-0.4, -0.2),
        commanded_acceleration=(-0.35, -0.15),
        levels=LEVELS,
        bounds=BOUNDS[1],
    )
    text = re.sub(r"<[^>]*>", " ", why_html(replace(blank, explanation=why)))
    for part in (
        "backward right, 143° to the right",
        "2.3·10⁻⁴",
        "98",
        "2.2·10⁻²",
        "−0.35",
        "92.90 m/s²",
        "4.20 rad/s²",
        "panda_joint4: torque limit",
        "80 mm (buffer 150 mm)",
        "0.70",
    ):
        assert part in text, part
    assert re.search(r"away from the arm\s+80\s+−0.40\s+\+0.00", text)
    assert re.search(r"towards higher score\s+60\s+\+0.00\s+−0.20", text)
    assert re.search(r"sum\s+100\s+−0.40\s+−0.20", text)


@pytest.mark.parametrize("kind", ["differential", "holonomic", "car-like", "of one's own"])
def test_panel_names_the_measure_of_the_base(blank, kind):
    why = explanation(NEAR["base"], base_kind=kind)
    html, paper = why_html(replace(blank, explanation=why)), kind == "differential"
    assert ("det(J Jᵀ)" in html) == ("sign · det · R" in html) == paper
    assert ("measure of the base" in html) == ("(10): measure · R" in html) == (not paper)


def test_text_inherits_its_colour_from_the_theme(blank):
    html = why_panel.details_html(
        replace(blank, explanation=explanation(NEAR["base"], levels=LEVELS))
    )
    assert not re.search(r'[;"]\s*color\s*:', html)


def test_unchanged_panel_is_not_sent_again(blank, monkeypatch):
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    panel = server.gui.add_html("")
    sent = []
    monkeypatch.setattr(server._websock_server, "queue_message", sent.append)
    one, two = (replace(blank, explanation=explanation(NEAR[near])) for near in ("base", "links"))
    for snapshot in (one, one, two, two, replace(blank, explanation=None)):
        panel.content = why_html(snapshot)
    assert len(sent) == 3
    assert "There is no explanation" in sent[-1].updates["content"]
    server.stop()
