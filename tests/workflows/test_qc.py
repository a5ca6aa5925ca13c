"""``replay-kit qc``: what each test did, told as a table and as JSON, and that a replay uses the same."""

import json

import pytest

from replay_kit.config.run import RunConfig, load_config
from replay_kit.core.errors import ConfigError, MeasurementError
from replay_kit.core.observation import Reason
from replay_kit.results import read_recorded
from replay_kit.workflows.info.qc import check_quality
from replay_kit.workflows.replay.inputs.job import ReplayJob
from replay_kit.workflows.replay.replay import replay
from tests import synthetic
from tests.command import succeed
from tests.measurements.carriers import json_mcap
from tests.measurements.samples import fix, ping
from tests.places import DATA, SAMPLES, needs
from tests.results.result_samples import decoded

CELLS = {
    "n_cells": 5,
    "cell_size": 20.0,
    "bin0_distance": 10.0,
    "velocity": [[0.1, 0.2, 0.0]] * 4 + [None],
}


def written(path, *messages):
    rows = [(m.time_ns // 10**9, m.topic, m.schema, m.payload) for m in messages]
    path.write_bytes(json_mcap(rows))
    return path


LOW = {
    "correlation": [90.0, 10.0, 90.0, 90.0, 90.0],
    "percent_good": [90.0, 90.0, 40.0, 90.0, 90.0],
}


@pytest.fixture
def log(tmp_path):
    """A vessel's log: a sound ping, one with a failed and a suspect bin, one that leans so far that it loses everything."""
    changes = {}, LOW, {"pitch": 50.0, "roll": 0.0}, {"coordinate_system": "instrument"}
    pings = [ping(k, **CELLS, **more) for k, more in enumerate(changes, start=1)]
    return written(tmp_path / "survey.mcap", fix(0), *pings, fix(5))


def test_each_test_says_what_it_did(log):
    said = succeed(f"qc {log} --json -", columns=200)
    answer = json.loads(said.stdout)
    (topic,) = answer["topics"]
    assert topic["pings"] == 3
    assert topic["bins"] == {"good": 6, "not_evaluated": 0, "suspect": 1, "fail": 5, "missing": 3}
    tests = {test["test"]: test for test in topic["tests"]}
    correlation = tests["correlation"]
    assert (correlation["evaluated"], correlation["failed"]) == (4, 1)
    assert (correlation["fail_when"], correlation["bit"]) == ("< 25 %", Reason.LOW_CORRELATION)
    (reason,) = correlation["not_evaluated"]
    assert (reason["reason"], reason["count"]) == ("the ping has no correlation", 8)
    assert (tests["tilt"]["evaluated"], tests["tilt"]["failed"]) == (4, 4)
    assert topic["pings_lost"] == 1
    assert answer["settings"]["quality"]["tilt_fail"] == 30.0
    for words in ("8 the ping has no correlation", "lose every bin: 1", "Not used: 1 x /adcp"):
        assert words in said.stderr


def test_the_configuration_moves_the_limits(log, tmp_path):
    (tmp_path / "run.toml").write_text(
        '[measurements.quality]\ntilt_fail = "off"\ntilt_suspect = "off"\ncorrelation_fail = 5.0\n'
    )
    said = succeed(f"qc {log} --config {tmp_path}/run.toml --json -")
    (topic,) = json.loads(said.stdout)["topics"]
    assert topic["bins"]["fail"] == 0
    assert topic["pings_lost"] == 0


def test_a_log_without_pings_is_unusable_and_says_what_it_has(tmp_path):
    alone = fix(0), ping(1, **CELLS, coordinate_system="instrument")
    log = written(tmp_path / "none.mcap", *alone)
    with pytest.raises(MeasurementError, match=r"expected ADCP pings.*1 x /adcp: heading is magn"):
        check_quality([log], RunConfig())


def test_a_damaged_log_says_so(log):
    log.write_bytes(log.read_bytes()[:-200])
    assert check_quality([log], RunConfig())["exit_code"] == 4


@pytest.mark.parametrize(
    "logs",
    [
        [SAMPLES / "survey.mcap", SAMPLES / "glider.mcap"],
        pytest.param(
            sorted((DATA / "seaglider").glob("p17101*.nc")),
            marks=[pytest.mark.full, needs(DATA / "seaglider")],
        ),
    ],
    ids=["samples", "seaglider"],
)
def test_sound_logs_lose_nothing(logs):
    """Bins that a test fails: none; suspect of anything but being at the surface: one in a thousand."""
    report = check_quality(logs, RunConfig())
    for topic in report["topics"]:
        assert topic["pings"] > 0
        assert topic["bins"]["fail"] == 0
        tests = {one["test"]: one for one in topic["tests"]}
        suspect = sum(one["suspect"] for name, one in tests.items() if name != "at_surface")
        assert suspect <= 1e-3 * tests["max_speed"]["evaluated"]
        assert topic["pings_lost"] == 0


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"snr_fail": 9.0}, "snr_suspect 6 is beyond snr_fail 9"),
        ({"nonsense": 9.0}, r"known here: .*snr_fail"),
    ],
)
def test_settings_are_checked(settings, words):
    with pytest.raises(ConfigError, match=words):
        load_config(None, {"measurements": {"quality": settings}})


def test_a_replay_publishes_flags_and_reasons_and_uses_what_is_left(log, tmp_path):
    synthetic.dataset(seed=4, n_members=8, shape=(5, 5)).to_netcdf(
        tmp_path / "ensemble.nc", engine="h5netcdf"
    )
    quality = {"snr_fail": 1.5, "outlier_fail": "off"}
    alone = load_config(None, {"time": {"window": 0.0}, "measurements": {"quality": quality}})
    summary, _ = replay(ReplayJob((log,), tmp_path / "ensemble.nc", tmp_path / "out.mcap"), alone)
    (tmp_path / "run.toml").write_text(read_recorded(tmp_path / "out.mcap").config_toml)
    assert load_config(tmp_path / "run.toml").measurements == alone.measurements
    counts = summary.observations
    assert [counts[name] for name in ("used", "rejected", "bins_used")] == [2, 1, 7]
    assert counts["bins_rejected"]["tilt"] == 5
    ((_, found),) = decoded(tmp_path / "out.mcap")["/flow/innovation"]
    assert (list(found.accepted), list(found.bins)) == ([True, True, False], [5, 5, 5])
    assert list(found.flags[5:]) == [1, 4, 3, 1, 9, 4, 4, 4, 4, 9]
    assert list(found.reasons[5:]) == [
        *(0, Reason.LOW_CORRELATION, Reason.LOW_PERCENT_GOOD, 0, Reason.MISSING),
        *[Reason.TILT] * 4,
        Reason.TILT | Reason.MISSING,
    ]
    used = [value == value for value in found.innovation_east[5:10]]
    assert used == [True, False, True, True, False]
