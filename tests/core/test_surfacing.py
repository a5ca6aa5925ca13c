"""Ellipses of surfacings, calibrated by those scored so far."""

from dataclasses import replace
from math import isnan, nan
from statistics import NormalDist
from types import SimpleNamespace

import numpy as np
import pytest

from replay_kit.core.geodesy import to_geographic, to_local
from replay_kit.core.grid import Projection
from replay_kit.core.observation import Fix
from replay_kit.core.surfacing import (
    CALIBRATING,
    DiveForecast,
    DiveOutcome,
    Ellipse,
    Surfacing,
    calibrated_forecast,
    ellipse_of,
    offset_between,
    prediction_scores,
    sequential_score,
    surfacing_outcome,
    usual_seconds,
)

DIVE_NS, RADII = 5 * 3600 * 10**9, (1.177, 2.146)


def outcomes_of(rng, count, too_small):
    """Surfacings, one a dive, that are farther from their places than the ellipses state, by a factor."""
    made = []
    for k in range(count):
        cov = np.diag(rng.uniform(100.0, 900.0, 2) ** 2)
        ellipses = (ellipse_of(10.0, 60.0, cov, radius) for radius in RADII)
        start = Fix(k * DIVE_NS, 10.0, 60.0)
        forecast = DiveForecast(k, k, start, start.time_ns + DIVE_NS, 10.0, 60.0, *ellipses, nan)
        off = too_small * np.sqrt(np.diag(cov)) * rng.standard_normal(2)
        at = (float(part) for part in to_geographic(Projection(10.0, 60.0), *off))
        made.append(DiveOutcome(forecast, Fix((k + 1) * DIVE_NS, *at), 0.0, 0.0, 0.0))
    return made


@pytest.mark.parametrize("too_small", [1.0, 2.0])
def test_calibrated_ellipses_hold_their_shares_whatever_the_stated_ones_hold(too_small):
    rng, inside = np.random.default_rng(3), []
    for _ in range(150):
        *earlier, last = outcomes_of(rng, 31, too_small)
        found = calibrated_forecast(last.forecast, earlier)
        assert found.scored == 30
        at = last.fix.longitude, last.fix.latitude
        ellipses = found.inner, found.outer, last.forecast.outer
        inside.append([ellipse.holds(*at) for ellipse in ellipses])
    half, nine, stated = np.mean(inside, axis=0)
    assert 0.42 < half < 0.62
    assert 0.86 < nine < 0.98
    assert (stated > 0.83) == (too_small == 1.0)


def test_later_surfacings_count_more_and_few_do_not_calibrate():
    rng = np.random.default_rng(5)
    before, after = outcomes_of(rng, 120, 1.0), outcomes_of(rng, 60, 3.0)
    later = [
        replace(one, fix=one.fix._replace(time_ns=one.fix.time_ns + 120 * DIVE_NS)) for one in after
    ]
    coming = replace(after[-1].forecast, start=Fix(180 * DIVE_NS, 10.0, 60.0))
    mixed, alike = (
        calibrated_forecast(coming, part).factor for part in (before + later, before + after)
    )
    assert mixed > alike > 1.0
    few = calibrated_forecast(coming, after[: CALIBRATING - 1])
    assert (few.outer, few.scored, isnan(few.factor)) == (coming.outer, CALIBRATING - 1, True)
    # as many are enough where they are not long ago
    assert isnan(calibrated_forecast(coming, after[:CALIBRATING]).factor)
    assert calibrated_forecast(after[CALIBRATING].forecast, after[:CALIBRATING]).factor > 1.5


def test_the_outline_of_an_ellipse_is_where_the_ellipse_ends():
    projection, ellipse = Projection(5.0, 62.0), Ellipse(5.1, 62.05, 900.0, 300.0, 30.0)
    outline = ellipse.outline(projection)
    np.testing.assert_array_equal(outline[0], outline[-1])
    centre = np.array(to_local(projection, 5.1, 62.05))
    for scale, inside in ((0.99, True), (1.01, False)):
        places = np.transpose(to_geographic(projection, *(centre + scale * (outline - centre)).T))
        assert {ellipse.holds(*place) for place in places.tolist()} == {inside}


def test_a_record_is_the_density_of_what_came_with_errors_scaled_by_those_so_far():
    rng, past, score = np.random.default_rng(3), np.empty((0, 2)), 0.0
    off, late = rng.rayleigh(700.0, 9), rng.normal(0.0, 500.0, 9)
    for one in np.column_stack([off, late]):
        squares = np.sum((past / [400.0, 900.0]) ** 2, axis=0) * [0.5, 1.0]
        place, time = np.array([400.0, 900.0]) ** 2 * (2.0 + squares) / (2.0 + len(past))
        score += np.log(np.exp(-0.5 * one[0] ** 2 / place) / (2.0 * np.pi * place))
        score += np.log(NormalDist(0.0, np.sqrt(time)).pdf(one[1]))
        past = np.vstack([past, one])
    assert sequential_score(off, late, np.tile([400.0, 900.0], (9, 1))) == pytest.approx(score)


def test_habit_and_plan_are_judged_by_the_surfacings_that_both_predicted():
    hour = 3600 * 10**9
    # a vehicle that goes east at 20 cm/s in dives of four hours, half an hour apart
    ends = [
        [Fix(int((4.5 * k + end) * hour), 5.0 + 0.04 * (k + end / 4.0), 62.0) for end in (0, 4)]
        for k in range(5)
    ]
    dives = [SimpleNamespace(forecast=SimpleNamespace(start=one), fix=fix) for one, fix in ends]
    assert prediction_scores(dives, ()) == (0, 0.0, 0.0)
    assert usual_seconds(dives[:4]) == 4 * 3600.0

    def planned(east, late=0):
        for _, fix in ends[2:]:
            planned = Surfacing(fix.time_ns, fix.longitude + east, 62.0)
            yield surfacing_outcome(0, planned, fix._replace(time_ns=fix.time_ns + late))

    (count, habit, wrong), (_, _, right) = (
        prediction_scores(dives, [*planned(x)]) for x in (0.02, 0.0)
    )
    assert count == 3
    assert habit > wrong < right
    # 20 minutes more or less of the way over ground beside 3 cm/s of the dive
    stated = [[np.hypot(0.03 * 14400.0, np.hypot(*offset_between(*ends[0])) / 12.0), 1200.0]] * 3
    assert habit == pytest.approx(
        sequential_score(np.zeros(3), np.zeros(3), np.array(stated)), abs=1e-3
    )
    # a surfacing of another dive is none of them
    assert prediction_scores(dives, [*planned(0.0, 2 * hour)])[0] == 0
