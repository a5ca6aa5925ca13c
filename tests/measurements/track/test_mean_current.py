"""Mean currents between fixes: their paths, exactly weighted, and where they come from."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.geodesy import to_geographic, to_local
from replay_kit.core.grid import Projection
from replay_kit.core.observation import PathMean
from replay_kit.measurements.means import Spot, extended_path, path_from, path_mean
from tests.measurements.samples import (
    CONFIG,
    SECOND,
    dac,
    fix,
    in_order,
    logged,
    only,
    reasons,
    run,
    the,
)
from tests.reference import path as slow

HERE = Projection(152.0, -40.0)
THROUGH_WATER = MeasurementConfig(dead_reckoning="through_water")


def dive(current=(0.0, 0.0), reckons=(0.0, 0.0), start_s=0):
    """A dive to 200 m and back at 0.25 m/s eastwards through water, ten minutes each way: what it logs, and the fixes."""
    messages = []
    for k in range(21):
        after = 60.0 * k
        depth = 200.0 - abs(k - 10) * 20.0
        drift = current if k in (0, 20) else reckons
        longitude, latitude = to_geographic(HERE, (0.25 + drift[0]) * after, drift[1] * after)
        reckoned = {"dead_reckoned": "true" if 0 < k < 20 else "false", "depth": str(depth)}
        metadata = [{"key": key, "value": value} for key, value in reckoned.items()]
        messages.append(fix(start_s + after, float(longitude), float(latitude), metadata=metadata))
    # the last dead-reckoned position is at the surface, where the fix comes too
    return messages


steps = st.tuples(st.floats(0.5, 2000.0), st.floats(-500.0, 500.0), st.floats(0.0, 1000.0))


@settings(max_examples=25, deadline=None)
@given(st.lists(steps, min_size=1, max_size=8), st.integers(1, 60))
def test_weights_sum_to_one_and_give_the_time_mean_of_the_polyline(walk, repeats):
    times, easts, depths = np.array([(0.0, 0.0, 0.0), *walk * repeats]).T
    times = np.cumsum(np.round(times, 3))
    longitude, latitude = to_geographic(HERE, easts, 0.0 * easts)
    way = {
        "time": np.round(times * SECOND).astype(np.int64),
        "longitude": longitude,
        "latitude": latitude,
        "depth": depths,
    }
    first, last = (Spot(*(column[k].item() for column in way.values())) for k in (0, -1))
    path = extended_path(path_from(first), {name: of[1:] for name, of in way.items()}, np.empty(0))
    mean = path_mean(path, last, (0.1, 0.2), 0.02)
    weight = mean["weight"]
    assert weight.sum() == pytest.approx(1.0, abs=1e-12)
    assert (weight > 0.0).all()
    assert weight.size <= 256
    assert (np.diff(mean["path_time"]) > 0).all()
    expected = slow.time_mean(times, depths)
    assert weight @ mean["path_depth"] == pytest.approx(expected, rel=1e-9, abs=1e-9)
    east, _ = to_local(HERE, mean["path_longitude"], mean["path_latitude"])
    assert weight @ east == pytest.approx(slow.time_mean(times, easts), rel=1e-6, abs=1e-3)


def test_a_stated_current_takes_the_dead_reckoned_path_moved_to_end_at_the_fix():
    mean = the(PathMean, [*dive(current=(0.1, -0.2)), dac(1200)])
    assert (mean.velocity, mean.error_std, mean.kind, mean.dive, mean.time_ns) == (
        (0.1, -0.2),
        0.03,
        "dac",
        3,
        1200 * SECOND,
    )
    seconds = mean.path_time_ns / SECOND
    east, north = to_local(HERE, mean.longitude, mean.latitude)
    # the last dead-reckoned position, 285 m on, is a minute before the fix, 420 m on: the rest is spread over the whole time
    under_way = seconds < 1140.0
    assert_allclose(
        east[under_way], (0.25 + (420.0 - 285.0) / 1200.0) * seconds[under_way], atol=0.1
    )
    assert_allclose(north, -0.2 * seconds, atol=0.01)


@pytest.mark.parametrize("comes", [1199, 1201, 1500])
def test_the_path_is_found_whenever_the_current_comes(comes):
    stated, after = dac(comes, end_s=1200, error=None), [fix(1260, depth=0.0), fix(1500, depth=0.0)]
    mean = the(PathMean, in_order(*dive(), *after, stated))
    assert mean.weight @ mean.depth == pytest.approx(100.0, abs=1.0)
    assert mean.error_std == pytest.approx(np.hypot(0.02, np.sqrt(2.0) * 20.0 / 1200.0))


def test_without_a_path_it_is_straight_down_and_up():
    kind = "sensor_msgs/FluidPressure"
    depths = [logged(kind, {"fluid_pressure": p}, k) for k, p in ((300, 2.1e6), (900, 4.0e5))]
    end = {"time": {"sec": 1200, "nsec": 0}, "lon": 152.01, "lat": -40.0}
    fixes = fix(0, depth=0.0), fix(1200, 152.01, depth=0.0)
    mean = the(PathMean, [fixes[0], *depths, fixes[1], dac(1200, end_fix=end)])
    deepest = mean.depth.max()
    assert deepest == pytest.approx(198.0, abs=4.0)
    assert mean.weight @ mean.depth == pytest.approx(deepest / 2.0, rel=0.01)
    assert_allclose(mean.longitude, 152.0 + 0.01 * mean.path_time_ns / (1200 * SECOND), atol=1e-6)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"dac_eastward": None}, "not a number"),
        ({"dac_northward": 60.0}, "faster than measurements.max_speed"),
        ({"start_fix": None}, "no path, and no fixes"),
        ({"start_fix": {"time": {"sec": "x"}, "lon": 1.0, "lat": 2.0}}, "no path, and no fixes"),
        ({}, "no path, and no fixes"),
        ({"max_depth": 0.0}, "no path, and no fixes"),
    ],
)
def test_currents_without_what_they_need_are_skipped_with_the_reason(changes, reason):
    events = run([fix(0), dac(1200, **changes)])
    assert not only(PathMean, events)
    assert reason in reasons(events)[0]


def test_dead_reckoning_through_water_gives_the_current_of_dives_without_one():
    current = (0.1, -0.2)
    messages = dive(current)
    assert not only(PathMean, run(messages, CONFIG))
    # a minute's way more, for the last dead-reckoned position is a minute before the fix
    mean = the(PathMean, messages, THROUGH_WATER)
    assert_allclose(mean.velocity, (current[0] + 0.25 * 60.0 / 1200.0, current[1]), atol=1e-5)
    assert (mean.kind, mean.dive) == ("dac", 1)
    # the log's own comes too late for the first dive, and is taken from then on
    events = run(
        [*messages, dac(1200), *dive(current, start_s=1300)[1:], dac(2500, 1300)], THROUGH_WATER
    )
    assert [mean.velocity[1] for mean in only(PathMean, events)] == [
        pytest.approx(-0.2, abs=1e-5),
        -0.2,
    ]
    assert "computed" in reasons(events)[0]


def test_a_stated_current_of_a_dive_that_begins_at_a_fix_thrown_off_is_left_out():
    track = [message for k in range(6) for message in dive(start_s=1500 * k)]
    stated = []
    for k, (start, longitude) in enumerate([(7440, -152.0), (7500, 152.0)]):
        at = {"time": {"sec": start, "nsec": 0}, "lon": longitude, "lat": -40.0}
        stated.append(dac(9000 + k, start, start_fix=at))
    events = run([*in_order(*track, fix(7440, -152.0)), *stated])
    assert "a fix of its dive is out of the vehicle's reach" in reasons(events)[-1]
    assert [mean.time_ns // SECOND for mean in only(PathMean, events)][-1] == 9001
