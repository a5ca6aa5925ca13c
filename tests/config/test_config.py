import tomllib
from dataclasses import replace

import pytest

from replay_kit.config.file import Section
from replay_kit.config.planner import PlannerConfig
from replay_kit.config.run import RunConfig, load_config
from replay_kit.core.as_flown import AsFlown
from replay_kit.core.errors import ConfigError
from replay_kit.core.words.quantities import parse_time
from replay_kit.workflows.replay.inputs.provenance import run_settings_toml


@pytest.fixture
def load(tmp_path):
    """Return a function that loads the configuration in a text, with options laid over it."""

    def loaded(text: str, options=None) -> RunConfig:
        path = tmp_path / "run.toml"
        path.write_text(text)
        return load_config(path, options)

    return loaded


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[planner]\nspeeed = 0.4\n", r"unknown key 'planner\.speeed'; known here: .*mean speed\?"),
        ("[plannner]\nspeed = 0.4\n", r"unknown key 'plannner'"),
        ("[planner]\nspeed = -1\n", r"run\.toml"),
        ("[planner]\nspeed = 30\n", r"expected up to 5 m/s, got 30; in cm/s\?"),
        ("[planner\n", r"run\.toml"),
        ("[estimator]\npreset = 'best'\n", r"run\.toml"),
    ],
)
def test_what_is_wrong_in_a_file_is_named(load, text, words):
    with pytest.raises(ConfigError, match=words):
        load(text)


def test_a_missing_file_is_said(tmp_path):
    with pytest.raises(ConfigError, match="cannot read"):
        load_config(tmp_path / "absent.toml")


def test_the_recorded_settings_read_back_as_the_same_configuration(load):
    estimator = {"modes": "all", "name": 'a "quoted" \\ text'}
    config = load_config(
        None, {"forecast": {"levels": (1.0, 20.0), "time": "2018-11-16"}, "estimator": estimator}
    )
    assert config.estimator.modes is None
    for each in (config, RunConfig()):
        assert load(run_settings_toml(each)) == each


@pytest.mark.parametrize(
    ("text", "time_ns"),
    [
        ("1970-01-01T00:00:01Z", 10**9),
        ("1970-01-01T00:00:01", 10**9),
        ("1970-01-01 01:00:01+01:00", 10**9),
        ("1969-12-31T23:00:00-01:00", 0),
        ("1970-01-02", 86_400 * 10**9),
        ("1970-01-01T00:00:00.5", 5 * 10**8),
        ("1970-01-01T00:00:00.000001234Z", 1234),
        ("1970-01-01T00:00:00.00000123Z", 1230),
        ("2262-04-11T23:47:16.854775807Z", 2**63 - 1),
    ],
)
def test_times_are_utc_unless_they_say_otherwise(text, time_ns):
    assert parse_time(text) == time_ns


@pytest.mark.parametrize(
    "text",
    [
        "yesterday",
        "now",
        "today",
        "NaT",
        "",
        "1542326400",
        "2018-13-01",
        "1969-12-31",
        "2262-04-11T23:47:16.854775808Z",
        "2262-04-12",
        "9999-12-31",
    ],
)
def test_other_times_are_refused_when_the_configuration_is_made(text):
    with pytest.raises(ConfigError, match=r"ISO 8601|1970\.\.2262"):
        parse_time(text)
    for section, key in (
        ("logs", "start"),
        ("logs", "end"),
        ("forecast", "time"),
        ("forecast", "reference_time"),
    ):
        with pytest.raises(ConfigError, match=rf"'{section}\.{key}': '{text}' is"):
            load_config(None, {section: {key: text}})


def test_a_start_after_the_end_is_refused():
    with pytest.raises(ConfigError, match=r"start .* is after end"):
        load_config(
            None,
            {"logs": {"start": "2018-11-16T00:00:00+00:00", "end": "2018-11-16T00:30:00+01:00"}},
        )
    load_config(None, {"logs": {"start": "2018-11-16T00:00Z", "end": "2018-11-16T01:00+01:00"}})


@pytest.mark.parametrize(
    ("section", "key", "value"),
    [
        ("output", "interval", "inf"),
        ("output", "depths", "[-0.5]"),
        ("planner", "interval", "nan"),
        ("logs", "reorder_window", "inf"),
        ("forecast", "region", "[150.0, nan, 151.0, 2.0]"),
        ("forecast", "levels", "[10.0, -1.0]"),
        ("forecast", "levels", "[inf]"),
        ("forecast", "window_points", "0"),
        ("measurements", "max_speed", "0.0"),
        ("estimator", "speed", "0.0"),
        ("estimator", "modes", "0"),
        ("estimator", "modes", "'most'"),
    ],
)
def test_numbers_outside_their_bounds_are_refused(load, section, key, value):
    with pytest.raises(ConfigError, match=rf"'{section}\.{key}"):
        load(f"[{section}]\n{key} = {value}\n")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a=" + "[" * 5000 + "]" * 5000, "not TOML: its values are nested too deeply"),
        ("[output]\nthreads=" + "9" * 5000, "not TOML: Exceeds the limit"),
        ("# a comment\n" * 30_000, "expected a configuration of at most 262144 bytes"),
        (".".join(["a"] * 5000) + "=1", r"unknown key 'a'; known here: .*output"),
        (
            "[output]\nthreads=" + "[" * 300 + "]" * 300,
            r"'output\.threads': Input should be a valid integer, got \[{5}\.\.\.\]{5}",
        ),
        (
            "[output]\nthreads='" + "x" * 100_000 + "'",
            r"'output\.threads': Input should be a valid integer.*, got 'x+\.\.\.x+'$",
        ),
        (
            "[output]\nthreads=1000000",
            r"'output\.threads': Input should be less than or equal to 1024, got 1000000",
        ),
        (
            "".join(f"a{k}=1\n" for k in range(23)),
            r"unknown key 'a19'; known here: .*; and 3 more$",
        ),
        (f"{'a' * 100_000}=1", r"unknown key 'a{200}';"),
        ("[planner]\nsamples=2", r": 'planner': samples: .* three or more, got 2$"),
    ],
)
def test_a_configuration_made_to_hurt_ends_with_a_short_error(load, text, words):
    with pytest.raises(ConfigError, match=words) as error:
        load(text)
    assert len(str(error.value)) < 5000


def test_a_mooring_of_no_hours_is_refused_by_the_name_of_its_option(load):
    plan = load("[plan]\nmooring = '5000,0'\n").plan
    with pytest.raises(ConfigError, match=r"--mooring: expected numbers above 0, got 5000,0"):
        _ = plan.mooring_numbers


FLOWN = AsFlown(speed=0.21, glide_angle_deg=57.0, depth=980.0, duration=6000.0, dives=5)


@pytest.mark.parametrize(
    ("stated", "flown", "deepest", "diving"),
    [
        ({}, None, 2000.0, (0.3, 500.0, 15.0, 35.0, "assumed: 0.30 m/s, dives to 500 m")),
        ({}, None, 300.0, (0.3, 300.0, 15.0, 35.0, "assumed: 0.30 m/s, dives to 300 m")),
        (
            {},
            FLOWN,
            2000.0,
            (0.21, 980.0, 57.0, 57.0, "as flown: 0.21 m/s, dives to 980 m, 1.7 h, 57 degrees"),
        ),
        (
            {},
            FLOWN,
            700.0,
            (0.21, 980.0, 57.0, 57.0, "as flown: 0.21 m/s, dives to 980 m, 1.7 h, 57 degrees"),
        ),
        (
            {"max_depth": 300.0},
            FLOWN,
            700.0,
            (
                0.21,
                300.0,
                57.0,
                57.0,
                "as flown: 0.21 m/s, dives to 300 m (flown to 980 m), 57 degrees",
            ),
        ),
        # the speed of another dive than the one flown
        ({"speed": 0.25}, FLOWN, 2000.0, (0.25, 980.0, 15.0, 35.0, "as flown: dives to 980 m")),
        (
            {"depth": 400.0},
            FLOWN,
            2000.0,
            (0.21, 400.0, 57.0, 57.0, "as flown: 0.21 m/s, 57 degrees"),
        ),
        (
            {"min_angle": 20.0, "max_angle": 30.0},
            FLOWN,
            2000.0,
            (0.21, 980.0, 20.0, 30.0, "as flown: 0.21 m/s, dives to 980 m, 1.7 h"),
        ),
        (
            {"max_angle": 40.0},
            FLOWN,
            2000.0,
            (0.21, 980.0, 40.0, 40.0, "as flown: 0.21 m/s, dives to 980 m, 1.7 h, 40 degrees"),
        ),
        ({"speed": 0.3, "depth": 500.0}, FLOWN, 2000.0, (0.3, 500.0, 15.0, 35.0, "")),
        ({"kind": "glide"}, FLOWN, 2000.0, (0.21, 980.0, 57.0, 57.0, "as flown: 0.21 m/s")),
        ({"kind": "glide"}, None, 2000.0, (0.3, 500.0, 15.0, 35.0, "assumed: 0.30 m/s")),
        (
            {},
            replace(FLOWN, dives=1),
            2000.0,
            (
                *(0.21, 980.0, 57.0, 57.0),
                "as flown in a single dive: 0.21 m/s, dives to 980 m, 1.7 h, 57 degrees",
            ),
        ),
        # a flight model gone wrong, or a vehicle with a propeller
        *(
            (
                {},
                replace(FLOWN, speed=speed),
                2000.0,
                (
                    *(0.3, 980.0, 15.0, 35.0),
                    f"assumed: 0.30 m/s, as the log's dives show {speed:.2f} m/s, which no glider flies (set --speed); "
                    "as flown: dives to 980 m",
                ),
            )
            for speed in (0.01, 2.0)
        ),
        (
            {"speed": 1.5, "depth": 50.0},
            replace(FLOWN, speed=2.0),
            2000.0,
            (1.5, 50.0, 15.0, 35.0, ""),
        ),
    ],
)
def test_what_no_setting_states_of_the_dives_is_as_flown_or_else_assumed(
    stated, flown, deepest, diving
):
    found = PlannerConfig(**stated).diving(flown, 0.0, deepest)
    assert (found.speed, found.depth, found.min_angle, found.max_angle, found.origin) == diving
    # what is not stated is not in the settings that a result records either, from which it is planned again
    recorded = tomllib.loads(run_settings_toml(RunConfig(planner=PlannerConfig(**stated))))[
        "planner"
    ]
    assert {
        key: recorded[key]
        for key in ("speed", "depth", "min_angle", "max_angle", "max_depth")
        if key in recorded
    } == {key: value for key, value in stated.items() if key != "kind"}


@pytest.mark.parametrize(
    ("text", "seconds"), [("36h", 129_600.0), ("2 d", 172_800.0), ("90s", 90.0), ("1.5min", 90.0)]
)
def test_a_duration_is_a_number_in_the_unit_of_its_setting_or_a_text_with_its_own(text, seconds):
    assert load_config(None, {"output": {"interval": text}}).output.interval == seconds
    assert load_config(None, {"time": {"scale": text}}).time.scale == seconds
    # a setting that is no time takes none
    with pytest.raises(ConfigError, match=r"measurements\.max_speed"):
        load_config(None, {"measurements": {"max_speed": text}})


@pytest.mark.parametrize(
    ("stated", "depth", "depths"),
    [("100:700", 700.0, (100.0, 700.0)), ("450", 450.0, None), (450.0, 450.0, None)],
)
def test_a_depth_is_a_number_or_a_range(stated, depth, depths):
    found = PlannerConfig(depth=stated).diving(FLOWN)
    assert (found.depth, found.depths) == (depth, depths)


@pytest.mark.parametrize(
    "wrong", [{"depth": "700:100"}, {"depth": "a:b"}, {"depth": -5}, {"speed": "0.3:0.4"}]
)
def test_what_is_no_range_is_refused(wrong):
    with pytest.raises(ValueError, match=r"expected a number above 0|convert|thrust"):
        PlannerConfig(**wrong)


@pytest.mark.parametrize("indent", ["", "    "])
def test_a_docstring_describes_settings_with_the_indentation_of_any_python(indent):
    """Python 3.13 compiles docstrings without it."""
    lines = ["Heights.", "", "Attributes:", "    low: Lowest height,", "        of the bottom [m]."]
    members = {"__doc__": f"\n{indent}".join(lines), "__annotations__": {"low": float}, "low": 1.0}
    made = type("Heights", (Section,), members | {"__module__": __name__})
    assert made.model_fields["low"].description == "Lowest height, of the bottom [m]."
