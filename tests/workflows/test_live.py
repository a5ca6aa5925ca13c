"""A replay that is fed message by message: what it says at any time, and that asking changes nothing."""

import numpy as np
import pytest
import xarray as xr

import replay_kit as rk
from replay_kit.core.errors import ConfigError
from replay_kit.logs.mcap.writer import write_mcap_log
from tests.workflows.replay.interrupted import QUICK

SETTINGS = {"estimator": QUICK, "measurements": {"flight_bias": False}}


def test_fed_message_by_message_and_asked_in_between_it_ends_with_the_estimate_of_a_replay(ocean):
    now = rk.live(ocean / "ensemble.nc", settings=SETTINGS)
    with rk.open_log(ocean / "glider.mcap") as log:
        messages = [*log.messages()]
        for k, message in enumerate(messages):
            now.feed([message])
            if k % 7 == 0:
                assert now.estimate.time_ns <= message.time_ns
    known = now.estimate
    # neither is in a replay, and both are told
    now.feed([messages[9], message._replace(topic="/vendor", schema="vendor/Adcp")], last=True)
    told = now.messages
    assert told[messages[9].topic, "later than the reorder window allows"] == 1
    assert sum(told.values()) == len(messages) + 2
    assert any(why for topic, why in told if topic == "/vendor")
    whole = rk.replay(ocean / "glider.mcap", ocean / "ensemble.nc", settings=SETTINGS).estimate
    for name in ("latent", "time_ns", "span_ns"):
        assert np.array_equal(getattr(now.estimate, name), getattr(whole, name))
    # what waits for others of its group is in the estimate before it ends
    assert known.latent == pytest.approx(whole.latent, abs=1e-6)
    assert now.findings == ()


def test_before_a_message_it_knows_the_forecast_alone(ocean):
    now = rk.live(xr.load_dataset(ocean / "ensemble.nc"), settings=SETTINGS)
    mean = rk.open_ensemble(ocean / "ensemble.nc").velocity.mean(axis=0)
    grid = now.estimate.grid
    at = grid.longitude[2, 2], grid.latitude[2, 2], grid.levels[0]
    assert now.estimate.velocity_at(*at).u == pytest.approx(mean[0, 0, 2, 2], abs=0.05)
    with pytest.raises(ConfigError, match="no message had a position"):
        now.plan((152.6, -40.0, 0.0))
    with pytest.raises(ConfigError, match="expected a list of Message, it holds dict"):
        now.feed([{}])


def test_it_plans_what_a_replay_of_the_same_messages_ends_with(ocean):
    goal = (152.3, -39.8, 150.0)
    now = rk.live(ocean / "ensemble.nc", settings=SETTINGS)
    with rk.open_log(ocean / "glider.mcap") as log:
        messages = list(log.messages())
    # the mean current of the first dive, which waits for others
    end = [one.topic for one in messages].index("/dac") + 1
    now.feed(messages[:end])
    found = now.plan(goal)
    write_mcap_log(ocean / "begin.mcap", messages[:end])
    whole = rk.replay(ocean / "begin.mcap", ocean / "ensemble.nc", settings=SETTINGS, goal=goal)
    last = whole.plans.iloc[-1]
    assert "as flown" in found.message
    assert (found.status, found.speed) == (last["status"], last["speed"])
    assert found.heading_deg == pytest.approx(last["heading_deg"], abs=0.1)
    assert found.duration == pytest.approx(last["duration"], rel=1e-3)
