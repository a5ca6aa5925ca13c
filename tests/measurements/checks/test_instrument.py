"""A dead, stuck or hanging instrument, its beams, its noise, its depths and speeds: named on what is wrong, silent on what is sound."""

import numpy as np
import pytest

from replay_kit.core.observation import Reason
from replay_kit.measurements.checks.instrument import BEAM, DEAD, DUPLICATES, STUCK
from replay_kit.measurements.checks.profile import (
    ENSEMBLE,
    ERRORS,
    SURFACE,
    UNIT,
    EnsembleSpeeds,
    ensemble_speeds,
    odd_ensemble_speeds,
)
from tests.measurements.checks.made import STEP, fix, judged, names, ping

CELLS = 12
ENSEMBLE_SPEEDS = EnsembleSpeeds(np.array([0.0, 100.0]), np.array([0.01, 0.01]))


def pings(number=40, noise=0.05, stated=0.05, seed=0, **changes):
    """Profiles of a diving vehicle whose current grows with depth."""
    rng = np.random.default_rng(seed)
    for k in range(number):
        depth = 60.0 * (k % 6) + 10.0 * np.arange(1.0, CELLS + 1.0)
        velocity = np.stack([0.1 + 1e-4 * depth, -5e-5 * depth], axis=1)
        velocity = velocity + noise * rng.standard_normal((CELLS, 2))
        yield ping(STEP * k, velocity, depth, stated, **changes)


def changed(events, change, since=0):
    """Pings whose velocities, raw and turned, become others from one on."""
    for k, (kind, columns) in enumerate(events):
        if k >= since:
            velocity = change(k, columns["velocity"].copy())
            columns = {**columns, "velocity": velocity, "raw": velocity}
        yield kind, columns


@pytest.mark.parametrize(("value", "words"), [(0.0, "all zero"), (0.1, "equal in all cells")])
def test_five_dead_pings_in_a_row_name_the_instrument_and_none_is_used(value, words):
    _, found, flags = judged(changed(pings(), lambda k, v: 0.0 * v + value, since=10))
    ((event, finding),) = found
    assert (event, finding.name) == (14, DEAD)
    assert words in finding.evidence
    assert [bool((each == 4).all()) for each, _ in flags] == [False] * 10 + [True] * 30
    assert all((reasons & Reason.DEAD).all() for _, reasons in flags[10:])


@pytest.mark.parametrize("vertical", [{}, {"w": np.nan}, {"w": 0.01}])
def test_cells_that_repeat_one_value_are_named_and_left_out_and_the_rest_is_used(vertical):
    def stuck(k, velocity):
        velocity[8:] = 0.3
        return velocity

    events = [
        (kind, one | {"raw": np.insert(one["raw"], [2] * len(vertical), [*vertical.values()], 1)})
        for kind, one in changed(pings(60), stuck)
    ]
    _, found, flags = judged(events)
    ((_, finding),) = found
    assert (finding.name, finding.severity) == (STUCK, "warning")
    assert "4 of 12 cells (9 to 12)" in finding.evidence
    assert [flag.tolist() for flag, _ in flags[-3:]] == [[1] * 8 + [4] * 4] * 3


def along_beams(change=lambda beams, rng: None, number=4, **changes):
    rng = np.random.default_rng(2)
    for kind, columns in pings(40, along_beams=1.0, **changes):
        beams = 0.05 * rng.standard_normal((CELLS, number))
        change(beams, rng)
        yield kind, {**columns, "raw": beams}


def noisy(beams, rng):
    beams[:, 2] += rng.standard_normal(CELLS)


def still(beams, rng):
    beams[:, 1] = 0.0


@pytest.mark.parametrize(("change", "number"), [(noisy, 3), (still, 2)])
def test_a_beam_that_is_noisy_or_dead_is_named_by_its_number(change, number):
    ((_, finding),) = judged(along_beams(change))[1]
    assert (finding.name, finding.distrusts) == (BEAM, True)
    assert f"beam {number} scatters" in finding.evidence


def looking_up(echo):
    """Pings of an instrument that hears echoes of a size above the surface."""
    rng = np.random.default_rng(0)
    distance = 2.0 + 2.0 * np.arange(15)
    for k, top in enumerate([60.0, 30.0, 12.0, 5.0, 8.0, 20.0] * 10):
        size = np.where(top < distance, echo, 0.05)[:, None]
        velocity = 0.1 + size * rng.standard_normal((15, 2))
        changes = {"up": 1.0, "transducer_depth": top, "distance": distance}
        yield ping(STEP * k, velocity, top - distance, **changes)


def later(kind, columns):
    return kind, {**columns, "time": columns["time"] + 40 * STEP}


def hangs(k, velocity):
    return KEPT[10] + 0.01 * np.random.default_rng(k).normal(size=velocity.shape)


HIGH = [(kind, {**one, "depth": -one["depth"]}) for kind, one in pings(12)]
KEPT = [one["velocity"] for _, one in pings()]
AT_SURFACE = {"reasons": np.full(CELLS, int(Reason.AT_SURFACE))}


@pytest.mark.parametrize(
    ("events", "named"),
    [
        (pings(), []),
        (changed(pings(), lambda k, v: v if k % 4 else 0.0 * v), [DEAD]),
        (changed(pings(), lambda k, v: v if k % 5 else 0.0 * v), []),
        # a repeated ping is stale within sixteen and not at the same time
        (changed(pings(), lambda k, v: KEPT[10] if k >= 10 else v), [DEAD]),
        (changed(pings(), lambda k, v: KEPT[k % 17]), []),
        ((event for event in pings(20) for _ in range(2)), [DUPLICATES]),
        ((fix(600.0 * (k // 2), 150.0 + 1e-3 * k, log=k % 2) for k in range(80)), []),
        # too few cells to be equal by fault
        ((ping(STEP * k, np.full((4, 2), 0.1)) for k in range(40)), []),
        ((ping(STEP * k, np.zeros((2, 2))) for k in range(40)), [DEAD]),
        # values of few digits repeat by chance
        (changed(pings(200), lambda k, v: np.round(v, 1)), []),
        *((pings(45, stated=stated), []) for stated in (0.05, 0.01, 0.4)),
        *((pings(45, stated=stated), [ERRORS]) for stated in (0.005, 5.0)),
        # of a model, on straight lines
        (changed(pings(45, noise=0.0), lambda k, v: v + 1e-3 * k), [ERRORS]),
        # correlated errors say nothing of the noise
        (pings(45, stated=5.0, correlation_depth=30.0), []),
        (along_beams(), []),
        (along_beams(error_velocity=0.02), []),
        (along_beams(error_velocity=0.3), [BEAM]),
        # another number of beams is another instrument
        ([*along_beams(still), *(later(*one) for one in along_beams(number=3))], [BEAM]),
        # a shape repeated with noise
        (changed(pings(), hangs, since=10), [DEAD]),
        (HIGH, [SURFACE]),
        ([*HIGH[:4], *pings(46)], []),
        ([(kind, one | AT_SURFACE) for kind, one in HIGH], []),
        (looking_up(0.6), []),
        (looking_up(0.05), [SURFACE]),
    ],
)
def test_a_fault_is_named_and_its_sound_neighbour_is_not(events, named):
    assert names(events) == named


@pytest.mark.parametrize(
    ("factor", "named"),
    [
        (1.0, []),
        (8.2, [ENSEMBLE]),
        (39.9, [ENSEMBLE]),
        (40.1, [UNIT]),
        (1 / 7.9, []),
        (1 / 10.1, [UNIT]),
    ],
)
def test_speeds_beyond_a_factor_of_eight_contradict_the_ensemble_and_name_a_unit_where_no_ocean_has_them(
    factor, named
):
    # sqrt(0.01) m/s along each ping, but for one bin that is odd
    cells = factor * 0.1 * np.tile([0.6, 0.8], (4, 1))
    cells = np.vstack([cells, [[1e6, 0.0]]])
    events = [ping(STEP * k, cells + 1e-9 * k, error=1e-6) for k in range(30)]
    _, found, _ = judged(events, ensemble=ENSEMBLE_SPEEDS)
    assert [one.name for _, one in found] == named
    assert [event for event, _ in found] == [29] * len(named)


def test_an_ensembles_speeds_are_those_of_its_levels():
    velocity = np.full((2, 2, 3, 1, 2), 0.3)
    velocity[:, :, 1] = 0.1
    velocity[:, :, 2] = np.nan
    velocity[0, :, 0, 0, 1] = np.nan
    speeds = ensemble_speeds(np.array([0.0, 50.0, 100.0]), velocity)
    assert speeds.mean_square == pytest.approx([0.18, 0.02, 0.18])
    for rms in (0.0, 0.0039, 0.0041, 1.49, 1.51):
        odd = odd_ensemble_speeds(np.full((2, 2, 1, 2, 2), rms / np.sqrt(2.0)))
        assert bool(odd) == (not 0.004 < rms < 1.5 and rms > 0.0)
