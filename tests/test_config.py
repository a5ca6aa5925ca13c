import pytest

from replay_kit.config import RunConfig, load_config, parse_time
from replay_kit.errors import ConfigError
from replay_kit.provenance import run_settings_toml


def test_an_unknown_key_is_an_error_that_names_the_known_ones(tmp_path):
    path = tmp_path / "run.toml"
    path.write_text("[planner]\nspeeed = 0.4\n")
    with pytest.raises(ConfigError, match=r"unknown key 'planner\.speeed'; known here: .*speed"):
        load_config(path)
    path.write_text("[plannner]\nspeed = 0.4\n")
    with pytest.raises(ConfigError, match=r"unknown key 'plannner'"):
        load_config(path)


@pytest.mark.parametrize("text", ["[planner]\nspeed = -1\n", "[planner\n", "[estimator]\npreset = 'best'\n"])
def test_bad_values_and_bad_syntax(tmp_path, text):
    path = tmp_path / "run.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=r"run\.toml"):
        load_config(path)


def test_options_win_over_the_file_and_none_is_no_option(tmp_path):
    path = tmp_path / "run.toml"
    path.write_text("[planner]\nspeed = 0.4\ntolerance = 10\n")
    config = load_config(path, {"planner": {"speed": 0.5, "tolerance": None}})
    assert (config.planner.speed, config.planner.tolerance) == (0.5, 10.0)


def test_a_missing_file_is_said(tmp_path):
    with pytest.raises(ConfigError, match="cannot read"):
        load_config(tmp_path / "absent.toml")


def test_the_recorded_settings_read_back_as_the_same_configuration(tmp_path):
    config = load_config(None, {"forecast": {"levels": (1.0, 20.0), "time": 'a "quoted" \\ text'}, "estimator": {"modes": 5}})
    path = tmp_path / "run.toml"
    path.write_text(run_settings_toml(config))
    assert load_config(path) == config
    path.write_text(run_settings_toml(RunConfig()))
    assert load_config(path) == RunConfig()


def test_times_are_utc():
    assert parse_time("1970-01-01T00:00:01Z") == 10**9
    with pytest.raises(ConfigError, match="ISO 8601"):
        parse_time("yesterday")
