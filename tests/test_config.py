"""Each parameter has a help text and enforced valid values; a number has a unit and a range."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from app.config import (
    FORMER_NAMES,
    Config,
    make_config,
    parameter,
    present_name,
    sections,
    slowed,
    tunable,
)
from app.errors import ConfigError

TUNABLES = [each for section in sections() for each in section.tunables]
PATHS = [each.path for each in TUNABLES if not each.choices]
UNITS = {
    "m",
    "rad",
    "m/s",
    "rad/s",
    "rad/s²",
    "N",
    "-",
    "m/s²",
    "1/s",
    "1/s²",
    "kg",
    "kg m²",
    "N s/m",
    "N m s",
    "N m/s",
    "s",
    "N/m",
    "m⁴/rad⁴",
}


@pytest.mark.parametrize("path", PATHS)
def test_every_parameter_has_a_range_around_its_default_and_a_known_unit(path):
    known = parameter(path)
    assert known.path == path
    assert known.low < known.high
    assert known.low <= known.default <= known.high
    section, name = path.split(".")
    assert known.default == getattr(getattr(Config(), section), name)
    assert known.unit in UNITS


@pytest.mark.parametrize("path", PATHS)
def test_both_ends_of_a_range_are_accepted_and_values_beyond_refused(path):
    known = parameter(path)
    section, name = path.split(".")
    for end in (known.low, known.high):
        assert getattr(getattr(Config().replace(path, end), section), name) == end
    step = 0.001 * (known.high - known.low)
    for beyond in (known.low - step, known.high + step, float("nan"), float("inf"), "much"):
        with pytest.raises(ConfigError, match=path):
            Config().replace(path, beyond)


def test_a_replacement_changes_one_parameter_of_a_copy():
    config = Config()
    changed = config.replace("border.d_b", 0.2)
    assert config == Config()
    assert changed.border.d_b == 0.2
    assert changed.border.eps == config.border.eps
    assert changed.replace("border.d_b", config.border.d_b) == config


@pytest.mark.parametrize("path", ["border.db", "bordr.d_b", "border", "", "border.d_b.x"])
def test_an_unknown_parameter_is_refused(path):
    with pytest.raises(ConfigError, match="no parameter"):
        Config().replace(path, 1.0)


def test_all_errors_are_reported_on_one_line():
    with pytest.raises(ConfigError) as caught:
        make_config({"border": {"d_b": 9.0, "epss": 0.01}})
    text = str(caught.value)
    assert "border.d_b" in text
    assert "did you mean 'eps'" in text
    assert "\n" not in text


def test_a_configuration_is_equal_after_writing_and_reading():
    config = Config().replace("repulsion.k_p", 12.5)
    assert make_config(config.model_dump()) == config
    assert Config.model_validate_json(config.model_dump_json()) == config


def test_records_are_frozen():
    with pytest.raises(ValidationError):
        Config().border.d_b = 0.2  # type: ignore[misc]


def test_slowed_gains_keep_the_damping_and_lower_the_frequencies():
    """Damping ratios stay; natural frequencies fall by the factor."""
    config = Config()
    slow = slowed(config)
    task, repulsion, limit = slow.task, slow.repulsion, slow.limit
    s = config.task.base_time_scale
    fast = config.task.ee_damping / (2 * config.task.ee_stiffness**0.5)
    assert task.ee_damping / (2 * task.ee_stiffness**0.5) == pytest.approx(fast)
    assert (task.ee_stiffness / config.task.ee_stiffness) ** 0.5 == pytest.approx(1 / s)
    assert repulsion.k_p * s**2 == pytest.approx(config.repulsion.k_p)
    assert repulsion.k_v * s == pytest.approx(config.repulsion.k_v)
    assert limit.position_rate * s == pytest.approx(config.limit.position_rate)
    assert limit.velocity_rate == limit.position_rate  # the same horizon
    assert slow.estimate == config.estimate


def test_the_kind_of_border_is_one_of_two() -> None:
    assert Config().replace("border.kind", "points").border.kind == "points"
    with pytest.raises(ConfigError, match=r"border\.kind"):
        Config().replace("border.kind", "cloud")


def test_sections_contain_every_parameter_of_the_records_once() -> None:
    assert [each.path for each in TUNABLES] == [
        f"{section}.{name}" for section, names in Config().model_dump().items() for name in names
    ]
    assert all(tunable(each.path) == each for each in TUNABLES)
    assert all(section.title and section.about for section in sections())


def test_every_parameter_has_a_short_unique_title_and_a_help_text() -> None:
    titles = [each.title for each in TUNABLES]
    assert len(set(titles)) == len(titles)
    assert [title for title in titles if len(title) > 31] == []
    assert [each.path for each in TUNABLES if not each.help] == []


def test_only_wide_ranges_have_a_logarithmic_scale() -> None:
    scales = {path: parameter(path).log for path in PATHS}
    assert (scales["task.slack_weight"], scales["task.ee_weight"]) == (True, True)
    assert (scales["border.d_b"], scales["force.f_max"]) == (False, False)


def test_every_section_has_a_basic_parameter() -> None:
    assert all(not all(each.advanced for each in section.tunables) for section in sections())


def test_a_choice_is_not_a_numeric_parameter() -> None:
    kind = tunable("border.kind")
    assert (kind.choices, kind.default) == (("surface", "points"), "surface")
    with pytest.raises(ConfigError, match="surface or points"):
        parameter("border.kind")


@pytest.mark.parametrize("value", ["0.2", True, None, [0.2], {"d_b": 0.2}, float("-inf")])
def test_a_value_that_is_no_number_is_refused_with_the_range(value: object) -> None:
    with pytest.raises(ConfigError, match=r"border\.d_b: must be within 0\.05 to 0\.3 m"):
        Config().replace("border.d_b", value)


def test_a_misspelt_parameter_gets_a_suggestion() -> None:
    with pytest.raises(ConfigError, match=r"did you mean 'border\.d_b'"):
        Config().replace("border.db", 0.1)
    with pytest.raises(ConfigError, match="did you mean 'admittance'"):
        make_config({"admitance": {}})
    with pytest.raises(ConfigError, match="border: must be a section"):
        make_config({"border": 0.1})


def test_thousands_of_errors_give_a_short_message() -> None:
    for count, counted in ((900, "and 892 more"), (5000, "5,000 wrong values")):
        with pytest.raises(ConfigError, match=counted) as caught:
            make_config({f"{'x' * 100}{i}": i for i in range(count)})
        assert len(str(caught.value)) < 2000


def test_every_former_name_sets_the_parameter_of_the_present_name(caplog):
    for former, path in FORMER_NAMES.items():
        present_name.cache_clear()
        value = 0.9 * Config().value(path)
        (old_section, old), (section, name) = former.split("."), path.split(".")
        expected = Config().replace(path, value)
        assert make_config({old_section: {old: value}}) == expected
        assert make_config({old_section: {old: value}}, Config()) == expected
        assert Config().replace(former, value) == expected
        with pytest.raises(ConfigError, match=f"{former} is the former name of {path}"):
            make_config({**{section: {name: value}}, **{old_section: {old: value, name: value}}})
        lines = [each.message for each in caplog.records if former in each.message]
        assert lines == [f"parameter {former} is now {path}"]
        caplog.clear()


def test_a_former_name_beside_another_parameter_of_its_section():
    given = {"task": {"softness": 0.01, "ee_weight": 1e4}, "barrier": {"leaving": 0.5}}
    task = make_config(given).task
    assert (task.slack_weight, task.ee_weight) == (0.01, 1e4)
