"""The smoothed result of logs: against the smoother itself, and against the replay where the two must agree."""

import numpy as np
import pytest

import replay_kit as rk
from replay_kit.config.run import load_config
from replay_kit.core.as_flown import AsFlown
from replay_kit.core.errors import LogError
from replay_kit.estimator import build
from replay_kit.estimator import smooth as smooth_states
from replay_kit.forecast import read_series
from replay_kit.logs import open_log
from replay_kit.logs.mcap.writer import write_mcap_log
from replay_kit.results.views.contents import Contents
from replay_kit.show.status.held import read_held
from replay_kit.workflows.planning.adapters import planner_of
from replay_kit.workflows.replay.inputs.job import ReplayJob
from replay_kit.workflows.smooth import STATIC, published_times, smooth
from replay_kit.workflows.verify import verify
from tests.places import SAMPLES
from tests.workflows.replay.interrupted import QUICK

STATIC_SETTINGS = {
    "logs": {"end": "2018-11-16T05:00:00Z"},
    "forecast": {"levels": [5, 150, 500]},
    "estimator": QUICK,
    "time": {"scale": "static"},
    "output": {"depths": [5.0, 150.0], "interval": 7200.0},
}
EVOLVING = {**STATIC_SETTINGS, "time": {"scale": 86_400.0}, "measurements": {"flight_bias": False}}


def smoothed(folder, settings, log=SAMPLES / "glider.mcap"):
    job = ReplayJob((log,), SAMPLES / "ensemble.nc", folder / "smoothed.mcap")
    summary = smooth(job, load_config(None, settings))
    return summary, rk.open_result(folder / "smoothed.mcap")


def test_grids_are_those_of_the_smoother_at_the_published_times(tmp_path):
    summary, result = smoothed(tmp_path, EVOLVING)
    with pytest.raises(LogError, match="got a smoothed one; verify the replay"):
        verify(tmp_path / "smoothed.mcap", [SAMPLES], planner_of)
    config = load_config(None, EVOLVING)
    estimator = build(
        read_series(SAMPLES / "ensemble.nc", config.forecast),
        config.estimator,
        config.gating,
        config.time,
    )
    log = open_log(SAMPLES / "glider.mcap", config=config.logs)
    end = config.logs.end_ns
    measured = [*rk.observations(one for one in log.messages() if one.time_ns <= end)]
    slices = Contents(result).slices
    states = smooth_states(estimator, measured, slices.time_ns.tolist())
    flows = [estimator.flow(state) for state in states]
    assert slices.time_ns.size == 4
    points = np.meshgrid(slices.east, slices.north)
    for k, flow in enumerate(flows):
        velocity = flow.velocity(*points, np.full(points[0].shape, 150.0))
        shown = np.moveaxis(slices.fields[1, k], 0, -1)[..., :2]
        known = np.isfinite(shown[..., 0])
        np.testing.assert_allclose(shown[known], velocity[known], atol=1e-6)
    assert summary.exit_code == 0
    assert STATIC not in summary.notes


def test_a_static_estimate_is_its_last_at_all_times(tmp_path):
    summary, result = smoothed(tmp_path, STATIC_SETTINGS)
    replayed = rk.replay(
        SAMPLES / "glider.mcap",
        SAMPLES / "ensemble.nc",
        settings=STATIC_SETTINGS,
        out=tmp_path / "replayed.mcap",
    )
    fields = Contents(result).slices.fields
    np.testing.assert_array_equal(fields[:, 0], fields[:, -1])
    np.testing.assert_allclose(fields[:, -1], Contents(replayed).slices.fields[:, -1], atol=1e-7)
    assert STATIC in summary.notes
    both = (AsFlown.in_metadata(read_held(one.reader).metadata) for one in (result, replayed))
    assert [one.dives for one in {*both}] == [1]
    assert result.events["message"].tolist() == [STATIC]


@pytest.mark.parametrize("fault", ["sign", "orientation"])
def test_a_log_that_contradicts_itself_is_judged_as_in_a_replay(tmp_path, fault):
    """Of wrong signs the profiles remain, against the mean currents; above the surface only these remain."""

    def wrong(message):
        if message.schema != "replay_kit.AdcpPing":
            return message
        velocity = (-np.array(message.payload["velocity"], float)).tolist()
        other = {"velocity": velocity} if fault == "sign" else {"orientation": "up"}
        return message._replace(payload=message.payload | other)

    log = tmp_path / "wrong.mcap"
    write_mcap_log(log, map(wrong, open_log(SAMPLES / "glider.mcap").messages()))
    settings = EVOLVING | {"logs": {"end": "2018-11-16T10:00:00Z"}}
    summary, result = smoothed(tmp_path, settings, log)
    with pytest.warns(UserWarning, match="check"):
        replayed = rk.replay(log, SAMPLES / "ensemble.nc", settings=settings).outcome
    assert (summary.exit_code, summary.consistency) == (6, replayed.consistency)
    assert (summary.outside, summary.observations) == (replayed.outside, replayed.observations)
    assert result.outcome.verdict == replayed.verdict
    assert ((result.innovations["flags"] == 1).sum() > 3) == (fault == "sign")


def test_published_times_begin_and_end_with_the_log():
    assert published_times(5, 5, 1.0) == [5]
    assert published_times(1, 10**9, 0.9) == [1, 900_000_001, 10**9]
