"""Raw values, depths, positions and speeds that cannot be."""

from dataclasses import replace

import numpy as np
import pytest

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.observation import RawValues, Reason
from replay_kit.logs import open_log
from replay_kit.measurements import initial_state, interpret
from replay_kit.measurements.consistency import findings, raw
from replay_kit.measurements.consistency.checks import DepthCounts, SpeedCounts
from replay_kit.measurements.consistency.monitor import Checked, ConsistencyState, check, unused
from replay_kit.measurements.consistency.position_checks import PositionRun
from replay_kit.measurements.consistency.raw import RawHistory
from replay_kit.measurements.consistency.summary import (
    EnsembleSpeeds,
    ensemble_speeds,
    odd_ensemble_speeds,
    summaries,
)
from tests.measurements.samples import profile, vehicle
from tests.places import DATA, needs


def _after(counts, one):
    (summary,) = summaries([one], ENSEMBLE)
    return counts.after(one, summary)


def ping(velocity, depth=None, std=0.01):
    return profile(
        velocity, np.linspace(10.0, 50.0, len(velocity)) if depth is None else depth, std
    )


def noise(seed=0, cells=6):
    return np.random.default_rng(seed).standard_normal((cells, 3))


def raw_values(velocity):
    (values,) = raw.raw_values(velocity[None])
    return values


def test_raw_values_tell_dead_cells_from_living_ones():
    assert raw_values(np.zeros((5, 3))).kind == "zero"
    assert raw_values(np.full((5, 3), 0.1)).kind == "constant"
    assert raw_values(noise()).kind == "varied"
    one_differs = np.zeros((5, 3))
    one_differs[3, 1] = 0.001
    assert raw_values(one_differs).kind == "varied"
    # the vertical component alone makes no instrument living
    assert raw_values(np.column_stack([np.zeros((5, 2)), np.arange(5.0)])).kind == "zero"


def test_too_few_cells_say_nothing():
    missing = np.vstack([np.full((4, 3), 0.1), np.full((3, 3), np.nan)])
    for cells in (missing, np.zeros((1, 2)), noise(cells=4)):
        # as text: what is not a number equals nothing
        assert repr(raw_values(cells)) == repr(RawValues())
    assert raw_values(np.zeros((2, 2))).kind == "zero"
    assert RawHistory().after(1, raw_values(missing)) == (RawHistory(), "")


def test_five_dead_pings_in_a_row_name_the_instrument():
    history = RawHistory()
    for number in range(5):
        assert not history.is_dead
        history, wrong = history.after(number, raw_values(np.zeros((5, 2))))
        assert wrong == "all zero"
    assert history.is_dead
    assert history.evidence == "the velocities of 5 of the last 5 pings are all zero"


def test_a_quarter_of_32_pings_names_it_too_and_fewer_do_not():
    def after(every):
        history, named = RawHistory(), []
        for number in range(32):
            cells = np.full((5, 2), 0.1) if number % every == 0 else noise(number)[:, :2]
            history, _ = history.after(number, raw_values(cells))
            named.append(history.is_dead)
        return named

    assert after(4)[-4:] == [True, True, True, True]
    assert after(4).index(True) == 28
    assert not any(after(5))


def test_a_repeated_ping_is_stale_within_sixteen_and_not_when_it_has_the_same_time():
    first = raw_values(noise())
    history, wrong = RawHistory().after(0, first)
    assert wrong == ""
    assert history.after(0, first)[1] == ""
    assert history.after(1, first)[1] == "equal to an earlier ping's"
    for number in range(1, 16):
        history, _ = history.after(number, raw_values(noise(number)))
    assert history.after(16, first)[1] == "equal to an earlier ping's"
    history, _ = history.after(16, raw_values(noise(16)))
    assert history.after(17, first)[1] == ""


def test_pings_with_most_bins_above_the_surface_are_counted():
    above, below, half = (
        ping(noise(cells=4)[:, :2], depth)
        for depth in ([-1, -2, -3, 4], [1, 2, 3, 4], [-1, -2, 3, 4])
    )
    at_surface = replace(above, reasons=np.full(4, Reason.AT_SURFACE, np.int32))
    counts = DepthCounts()
    for one in (below, half, at_surface):
        counts = _after(counts, one)
    assert counts == DepthCounts(2, 0)
    for number in range(5):
        assert not counts.is_wrong
        counts = _after(counts, above)
        assert counts.above == number + 1
    assert counts.is_wrong
    assert not DepthCounts(50, 5).is_wrong
    assert DepthCounts(49, 5).is_wrong


def state(seconds, longitude, depth):
    return vehicle(seconds, longitude, depth=depth, dead_reckoned=True)


def run(*states):
    found = PositionRun()
    for one in states:
        found = found.after(one)
    return found


def test_a_position_that_stays_while_the_vehicle_dives_is_frozen():
    dive = [state(200.0 * k, 150.0, 7.0 * k) for k in range(4)]
    assert run(*dive).is_unusable
    # one short of each bound
    assert not run(*dive[:3]).is_unusable
    assert not run(*(state(199.9 * k, 150.0, 7.0 * k) for k in range(4))).is_unusable
    assert not run(*(state(200.0 * k, 150.0, 20.0 / 3.0 * k - 1e-9) for k in range(4))).is_unusable
    assert not run(*(state(200.0 * k, 150.0, float("nan")) for k in range(4))).is_unusable
    assert not run(*(state(200.0 * k, 150.0 + 1e-9 * k, 7.0 * k) for k in range(4))).is_unusable


def test_a_last_fix_that_is_repeated_under_water_is_no_contradiction_until_a_new_fix_repeats_it():
    dive = [state(200.0 * k, 150.0, 7.0 * k) for k in range(4)]
    surfaced = vehicle(800.0, 150.0, depth=0.0)
    found = run(*dive).found(dive[-1], frozenset())
    assert (found.name, found.severity) == (findings.REPEATED, "warning")
    found = run(*dive, surfaced).found(surfaced, frozenset())
    assert (found.name, found.severity) == (findings.FROZEN, "inconsistent")


@needs(DATA)
def test_a_real_glider_that_repeats_its_last_fix_under_water_contradicts_nothing():
    checked, measured = ConsistencyState(), initial_state()
    for message in open_log(DATA / "glider/seaexplorer/sea046.45.gli.sub.10.gz").messages():
        measured, events = interpret(measured, message, MeasurementConfig())
        for event in events:
            if isinstance(event, Checked):
                checked, _ = check(checked, event)
    assert [(one.name, one.severity) for one in checked.findings] == [
        (findings.REPEATED, "warning")
    ]


def test_the_depths_of_a_run_are_those_known():
    found = run(
        *(
            state(200.0 * k, 150.0, depth)
            for k, depth in enumerate([float("nan"), 30.0, float("nan"), 5.0])
        )
    )
    assert (found.shallowest, found.deepest, found.fixes) == (5.0, 30.0, 4)
    assert found.is_unusable


ENSEMBLE = EnsembleSpeeds(np.array([0.0, 100.0]), np.array([0.01, 0.01]))


@pytest.mark.parametrize(
    ("factor", "far", "odd"),
    [
        (1.0, False, False),
        (7.9, False, False),
        (8.2, True, False),
        (39.9, True, False),
        (40.1, True, True),
        (100.0, True, True),
        (1 / 7.9, False, False),
        (1 / 8.2, True, False),
        (1 / 9.9, True, False),
        (1 / 10.1, True, True),
    ],
)
def test_speeds_beyond_a_factor_of_eight_contradict_the_ensemble_and_are_odd_where_no_ocean_has_them(
    factor, far, odd
):
    counts = SpeedCounts()
    # sqrt(0.01) m/s along each ping
    cells = factor * 0.1 * np.tile([0.6, 0.8], (5, 1))
    for _ in range(30):
        assert not counts.contradict_ensemble
        assert not counts.is_odd
        counts = _after(counts, ping(cells, std=1e-6))
    assert counts.contradict_ensemble is far
    assert counts.is_odd is odd
    assert counts.ratio == pytest.approx(factor)


def test_noise_alone_is_not_fast():
    # 1 m/s of stated error in each component, and as much measured
    counts = _after(SpeedCounts(), ping(np.ones((5, 2)), std=1.0))
    assert (counts.pings, counts.fast, counts.slow) == (1, 0, 0)


def test_one_outlier_among_the_bins_changes_nothing():
    cells = np.tile([0.06, 0.08], (5, 1))
    cells[2] = 1e6
    assert _after(SpeedCounts(), ping(cells, std=1e-6)).fast == 0


def test_an_ensembles_speeds_are_those_of_its_levels():
    velocity = np.full((2, 2, 3, 1, 2), 0.3)
    velocity[:, :, 1] = 0.1
    velocity[:, :, 2] = np.nan
    velocity[0, :, 0, 0, 1] = np.nan
    speeds = ensemble_speeds(np.array([0.0, 50.0, 100.0]), velocity)
    assert speeds.mean_square == pytest.approx([0.18, 0.02, 0.18])


@pytest.mark.parametrize(
    ("rms", "odd"), [(0.0039, True), (0.0041, False), (1.49, False), (1.51, True), (15.0, True)]
)
def test_an_ensemble_faster_or_slower_than_any_ocean_is_odd(rms, odd):
    assert bool(odd_ensemble_speeds(np.full((2, 2, 1, 2, 2), rms / np.sqrt(2.0)))) is odd


def test_an_ensemble_at_rest_or_with_a_fast_corner():
    assert odd_ensemble_speeds(np.zeros((2, 2, 1, 2, 2))) == ""
    velocity = np.full((1, 2, 1, 10, 10), 0.1)
    velocity[0, :, 0, 0, 0] = 4.0
    assert odd_ensemble_speeds(velocity) == "RMS speed 0.583 m/s, 99.9 % below 5.37 m/s"


def test_unused_bins_fail_with_the_reason_and_those_that_failed_keep_theirs():
    one = replace(
        ping(np.ones((3, 2))),
        flags=np.array([1, 3, 9], np.int8),
        reasons=np.array([0, 2048, 1], np.int32),
    )
    after = unused(one, Reason.DEAD)
    assert after.flags.tolist() == [4, 4, 9]
    assert after.reasons.tolist() == [8388608, 2048 + 8388608, 1]
    assert one.flags.tolist() == [1, 3, 9]
