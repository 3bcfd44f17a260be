"""Configurations survive a round trip through a file; errors of a file are reported."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from app.config import Config, Parameter, make_config, sections
from app.config_file import (
    LONGEST_NAME,
    MAX_BYTES,
    checked_name,
    decode_config,
    read_config,
    save_config,
)
from app.errors import ConfigError
from app.strict import LARGEST_TEXT


def values(about: Parameter) -> st.SearchStrategy[float | str]:
    """All valid values of a parameter."""
    if about.choices:
        return st.sampled_from(about.choices)
    return st.floats(about.low, about.high)


configs = st.fixed_dictionaries(
    {
        section.name: st.fixed_dictionaries(
            {each.path.partition(".")[2]: values(each) for each in section.tunables}
        )
        for section in sections()
    }
).map(make_config)
names = st.text(max_size=LONGEST_NAME).filter(str.isprintable)


def test_a_parameter_under_both_of_its_names_is_refused_with_them_alone():
    text = b"[holding]\nspeed = 0.3\n[ee_hold]\nmin_speed = 0.2\n"
    with pytest.raises(ConfigError) as refused:
        decode_config(text)
    both = "holding.speed is the former name of ee_hold.min_speed: state only one of them"
    assert str(refused.value) == both


@settings(max_examples=20)  # each draws every parameter
@given(configs, names)
def test_configuration_survives_a_round_trip(config: Config, name: str) -> None:
    text = save_config(config, name)
    assert decode_config(text.encode())[:2] == (name.strip(), config)
    if name.isascii():
        assert decode_config(text.replace("\n", "\r\n").encode("utf-8-sig")).config == config


def test_only_changed_parameters_name_their_default() -> None:
    config = Config().replace("border.d_b", 0.2).replace("border.kind", "points")
    marked = [line for line in save_config(config).splitlines() if "program's default" in line]
    assert marked == [
        "d_b = 0.2 # the program's default is 0.15",
        'kind = "points" # the program\'s default is "surface"',
    ]
    assert "program's default" not in save_config(Config())


def test_comment_above_each_parameter_gives_unit_range_and_meaning() -> None:
    lines = save_config(Config()).splitlines()
    for section in sections():
        begin = lines.index(f"[{section.name}]")
        assert lines[begin + 1] == f"# {section.about}"
        for each in section.tunables:
            name = each.path.partition(".")[2]
            at = next(i for i in range(begin, len(lines)) if lines[i].startswith(f"{name} = "))
            assert each.help in lines[at - 1]
            if not each.choices:
                assert f"[{each.unit}] {each.low:.15g} to {each.high:.15g}" in lines[at - 1]


def test_file_may_contain_only_some_parameters() -> None:
    assert decode_config(b"") == ("", Config(), ())
    found = decode_config(b"name = 'soft'\n[hand]\nstiffness = 100\n")
    assert found == ("soft", Config().replace("hand.stiffness", 100.0), ())


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[border]\nd_bb = 0.1", r"border\.d_bb.*did you mean 'd_b'"),
        ("[bordr]\nd_b = 0.1", "did you mean 'border'"),
        ("[border]\nd_b = 9", r"border\.d_b: must be within 0\.05 to 0\.3 m \(was 9\)"),
        ("[border]\nd_b = nan", r"within 0\.05 to 0\.3 m \(was nan\)"),
        ("[border]\nd_b = '0.1'", r"within 0\.05 to 0\.3 m"),
        ("[border]\nkind = 'cloud'", "must be surface or points"),
        ("[border\n", "not TOML.*line 1"),
        ("x = " + "[" * 20_000, "not TOML"),
        ("x = " + "1" * 9_000, "not TOML"),
        ("name = 3", "name"),
        ('name = "a\\nb"', "name.*printable"),
        (f"name = '{'a' * 61}'", "name.*60 characters"),
    ],
)
def test_mistake_in_a_file_is_one_short_line(text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message) as caught:
        decode_config(text.encode())
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 300


def test_error_names_the_file_that_cannot_be_read(tmp_path) -> None:
    with pytest.raises(ConfigError, match=r"gone\.toml: No such file"):
        read_config(tmp_path / "gone.toml")
    with pytest.raises(ConfigError, match="Is a directory"):
        read_config(tmp_path)
    for content, message in (
        (b"#" * (2 * MAX_BYTES), f"{2 * MAX_BYTES} bytes"),
        (b"#" * (LARGEST_TEXT + 1), "more than 10 MB"),
        (b"\xff\xfe\x00", "UTF-8"),
        (b"[hand]\nf_max = 0.0", r"hand\.f_max"),
    ):
        path = tmp_path / "mine.toml"
        path.write_bytes(content)
        with pytest.raises(ConfigError, match=rf"mine\.toml: .*{message}"):
            read_config(path)


def test_unprintable_or_long_names_are_rejected() -> None:
    for name in ("a\nb", "\x00", "\ud800", "a" * 61):
        with pytest.raises(ConfigError, match="name"):
            save_config(Config(), name)
    assert checked_name("  stiff arm ☃ ") == "stiff arm ☃"


def test_allowed_hosts_are_separate_from_the_controllers_parameters() -> None:
    text = '[server]\nallow_host = ["Robot.local", "bücher.example", "my_service"]\n'
    read = decode_config(text.encode())
    assert read.hosts == ("robot.local", "xn--bcher-kva.example", "my_service")
    assert read.config == Config()


@pytest.mark.parametrize(
    "hosts",
    [
        '"robot.local"',
        "[1]",
        '["http://robot.local"]',
        '["robot:8080"]',
        '["*"]',
        '["a..b"]',
        '[""]',
    ],
)
def test_invalid_host_is_rejected(hosts: str) -> None:
    with pytest.raises(ConfigError, match=r"robot\.local"):
        decode_config(f"[server]\nallow_host = {hosts}\n".encode())
