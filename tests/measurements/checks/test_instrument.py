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


@pytest.mark.parametrize(
    ("change", "words"),
    [(lambda k, v: 0.0 * v, "all zero"), (lambda k, v: 0.0 * v + 0.1, "equal in all cells")],
)
def test_five_dead_pings_in_a_row_name_the_instrument_and_none_is_used(change, words):
    _, found, flags = judged(changed(pings(), change, since=10))
    ((event, finding),) = found
    assert (event, finding.name) == (14, DEAD)
    assert words in finding.evidence
    assert [bool((each == 4).all()) for each, _ in flags] == [False] * 10 + [True] * 30
    assert all((reasons & Reason.DEAD).all() for _, reasons in flags[10:])


@pytest.mark.parametrize(("every", "named"), [(4, [DEAD]), (5, [])])
def test_a_quarter_of_32_pings_names_it_too_and_fewer_do_not(every, named):
    bad = changed(pings(), lambda k, v: v if k % every else 0.0 * v)
    assert names(bad) == named


def test_a_repeated_ping_is_stale_within_sixteen_and_not_at_the_same_time():
    kept = []

    def repeated(k, velocity):
        kept.append(velocity)
        return kept[10] if k >= 10 else velocity

    assert names(changed(pings(), repeated)) == [DEAD]
    twice = [event for event in pings(20) for _ in range(2)]
    assert DEAD not in names(twice)
    far = list(changed(pings(), lambda k, v: kept[k % 17]))
    assert names(far) == []


def test_too_few_cells_say_nothing():
    few = [ping(STEP * k, np.full((4, 2), 0.1)) for k in range(40)]
    assert names(few) == []
    assert names([ping(STEP * k, np.zeros((2, 2))) for k in range(40)]) == [DEAD]


def test_an_instrument_that_repeats_one_shape_with_noise_is_named_with_the_time():
    rng, kept = np.random.default_rng(1), {}

    def hangs(k, velocity):
        kept.setdefault("v", velocity)
        return kept["v"] + 0.01 * rng.standard_normal(velocity.shape)

    ((_, finding),) = judged(changed(pings(), hangs, since=10))[1]
    assert (finding.name, finding.distrusts) == (DEAD, True)
    assert 8 * STEP <= finding.since_ns * 1e-9 <= 12 * STEP
    assert names(pings()) == []


def test_profiles_of_a_model_are_smooth_and_alike_and_still_used():
    model = changed(pings(60, noise=0.0), lambda k, v: v + 1e-3 * np.sin(0.1 * k))
    _, found, flags = judged(model)
    assert [one for _, one in found if one.severity != "warning"] == []
    assert all((each == 1).all() for each, _ in flags)


def test_cells_that_repeat_one_value_are_named_and_left_out_and_the_rest_is_used():
    def stuck(k, velocity):
        velocity[8:] = 0.3
        return velocity

    _, found, flags = judged(changed(pings(60), stuck))
    ((_, finding),) = found
    assert (finding.name, finding.severity) == (STUCK, "warning")
    assert "4 of 12 cells (9 to 12)" in finding.evidence
    assert [flag.tolist() for flag, _ in flags[-3:]] == [[1] * 8 + [4] * 4] * 3


def test_values_of_few_digits_repeat_by_chance():
    coarse = changed(pings(200), lambda k, v: np.round(v, 1))
    assert STUCK not in names(coarse)


@pytest.mark.parametrize(
    ("stated", "named"),
    [
        (0.05, []),
        (0.01, []),
        (0.4, []),
        (0.005, [(ERRORS, "inconsistent")]),
        (5.0, [(ERRORS, "warning")]),
    ],
)
def test_stated_errors_are_named_when_the_bins_scatter_otherwise(stated, named):
    found = judged(pings(45, stated=stated))[1]
    assert [(one.name, one.severity) for _, one in found] == named


def test_correlated_errors_say_nothing_of_the_noise():
    assert names(pings(45, stated=5.0, correlation_depth=30.0)) == []


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
    assert names(along_beams()) == []


@pytest.mark.parametrize(("error", "named"), [(0.02, []), (0.3, [BEAM])])
def test_beams_that_contradict_each_other_in_all_cells_are_named(error, named):
    assert names(along_beams(error_velocity=error)) == named


def test_an_instrument_with_another_number_of_beams_is_another():
    bad = list(along_beams(still))
    later = [
        (kind, {**one, "time": one["time"] + 40 * STEP}) for kind, one in along_beams(number=3)
    ]
    _, found, flags = judged([*bad, *later])
    # what a bad one has shown says nothing of the sound one after it
    assert [one.name for _, one in found] == [BEAM]
    assert all((each == 1).all() for each, _ in flags[-40:])


def test_messages_that_come_twice_are_a_warning_and_those_of_two_logs_are_not():
    places = [fix(600.0 * k, 150.0 + 1e-3 * k) for k in range(40)]
    ((_, finding),) = judged([one for one in places for _ in range(2)])[1]
    assert (finding.name, finding.severity) == (DUPLICATES, "warning")
    other = [one for k, each in enumerate(places) for one in (each, fix(600.0 * k, log=1))]
    assert DUPLICATES not in names(other)
    assert names(event for event in pings(20) for _ in range(2)) == [DUPLICATES]


def test_bins_above_the_surface_name_a_sign_of_depth_after_five_pings():
    high = [(kind, {**one, "depth": -one["depth"]}) for kind, one in pings(12)]
    ((event, finding),) = judged(high)[1]
    assert (event, finding.name, finding.distrusts) == (4, SURFACE, True)
    few = [*high[:4], *list(pings(46))]
    assert names(few) == []
    at_surface = [
        (kind, {**one, "reasons": np.full(CELLS, int(Reason.AT_SURFACE))}) for kind, one in high
    ]
    assert names(at_surface) == []


@pytest.mark.parametrize(("echo", "named"), [(0.6, []), (0.05, [SURFACE])])
def test_an_instrument_that_looks_up_hears_echoes_above_the_surface(echo, named):
    rng = np.random.default_rng(0)

    def looking_up(k, top):
        distance = 2.0 + 2.0 * np.arange(15)
        depth = top - distance
        size = np.where(depth < 0.0, echo, 0.05)[:, None]
        velocity = 0.1 + size * rng.standard_normal((15, 2))
        return ping(STEP * k, velocity, depth, up=1.0, transducer_depth=top, distance=distance)

    dives = [looking_up(k, top) for k, top in enumerate([60.0, 30.0, 12.0, 5.0, 8.0, 20.0] * 10)]
    assert names(dives) == named


@pytest.mark.parametrize(
    ("factor", "named"),
    [
        (1.0, []),
        (7.9, []),
        (8.2, [ENSEMBLE]),
        (39.9, [ENSEMBLE]),
        (40.1, [UNIT]),
        (100.0, [UNIT]),
        (1 / 7.9, []),
        (1 / 8.2, [ENSEMBLE]),
        (1 / 9.9, [ENSEMBLE]),
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


def test_noise_alone_is_not_fast():
    events = [ping(STEP * k, np.ones((5, 2)) + 1e-3 * k, error=1.0) for k in range(40)]
    assert ENSEMBLE not in names(events, ensemble=ENSEMBLE_SPEEDS)


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
    assert odd_ensemble_speeds(np.zeros((2, 2, 1, 2, 2))) == ""
