"""Whether a flight model errs: evidence against one Gaussian of all dives, and what one wrong mean current does."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from replay_kit.estimator.next_dive import corrections
from replay_kit.estimator.next_dive.corrections import LEAST_EVIDENCE, FlightBias
from replay_kit.estimator.next_dive.process import DiveMean, MeanCurrentProcess, ProcessSettings
from tests.reference import mean_currents as slow

HOUR = 3600.0
WRONG = ((0.3, 0.0), (-0.1, -0.1))


def dives(n, bias, seed=0, turn=2.1, inverted=False):
    """Dives of a turning course in a current that changes slowly, with a flight model that errs by a share of the way."""
    rng = np.random.default_rng(seed)
    out, changing = [], 0.0
    for k in range(n):
        changing = 0.9 * changing + 0.02 * complex(*rng.normal(size=2))
        way, current = 0.22 * np.exp(1j * turn * k), complex(0.08, -0.03) + changing
        mean = current + bias * way
        parts = [np.array([part.real, part.imag]) for part in (way, mean, current)]
        out.append(
            DiveMean(
                int(k * 4 * HOUR * 1e9),
                3 * HOUR,
                parts[0],
                parts[1],
                parts[2] if inverted else None,
            )
        )
    return out


def with_wrong(given, k, error):
    """The same with one mean current that is wrong: between the same fixes the way through the water is then wrong as well."""
    wrong = replace(given[k], velocity=given[k].velocity + error, way=given[k].way - error)
    return [*given[:k], wrong, *given[k + 1 :]]


def after(given):
    """What is known before each dive, and after the last."""
    states = [FlightBias()]
    for dive in given:
        states.append(states[-1].after(dive))
    return states


@pytest.mark.parametrize("inverted", [False, True])
def test_the_evidence_is_that_of_gaussians_of_all_dives_at_once(inverted, monkeypatch):
    given = dives(4, 0.3, inverted=inverted)
    monkeypatch.setattr("replay_kit.estimator.next_dive.process._UNLIKE", 1e-40)
    process = MeanCurrentProcess(ProcessSettings.drawn(24), outliers=True)
    state = process.initial()
    for dive in given:
        state = process.step(state, dive)
    joints = [slow.joint(given, process.settings, h) for h in range(24)]
    densities = np.array([multivariate_normal(cov=cov).logpdf(values) for values, cov in joints])
    has = process.settings.flight > 0.0
    expected = (
        logsumexp(densities[has]) - logsumexp(densities[~has]) - np.log(has.sum() / (~has).sum())
    )
    assert process.flight_evidence(process.initial()) == pytest.approx(0.0, abs=1e-12)
    assert process.flight_evidence(state) == pytest.approx(expected, rel=1e-6)


def test_an_error_is_believed_once_no_single_dive_is_needed_for_it():
    states = after(dives(8, 0.5))
    assert [state.is_believed for state in states[:3]] == [False] * 3
    assert states[-1].is_believed
    share, std = states[-1].share
    assert np.all(np.abs(share - [0.5, 0.0]) < 3.0 * std)
    assert np.all(std < 0.1)
    assert states[-1].dives == 8


@pytest.mark.parametrize("seed", [2, 5])
def test_a_glider_that_holds_station_with_a_sound_flight_model_shows_no_error(seed):
    """Its way is against the current, so that chance among the settings of the current looks like an error of the model."""
    rng, place, changing, state = np.random.default_rng(seed), 0j, 0j, FlightBias()
    steady = 0.08 * complex(*rng.normal(size=2))
    for k in range(40):
        changing = 0.95 * changing + 0.02 * complex(*rng.normal(size=2))
        way = -steady - changing - place / (4 * HOUR)
        way *= min(1.0, 0.25 / abs(way))
        mean = steady + changing + 0.01 * complex(*rng.normal(size=2))
        place += 3 * HOUR * (steady + changing + way)
        parts = [np.array([part.real, part.imag]) for part in (way, mean)]
        state = state.after(DiveMean(int(4e9 * k * HOUR), 3 * HOUR, *parts, None))
    assert state.evidence < LEAST_EVIDENCE


def test_the_evidence_counts_without_the_dive_on_which_it_rests():
    given = dives(5, 0.5)
    found = after(given)[-1]
    model = MeanCurrentProcess(ProcessSettings.paired(64), outliers=True)
    least = []
    for left_out in (None, *range(5)):
        state = model.initial()
        for k, dive in enumerate(given):
            state = state if k == left_out else model.step(state, dive)
        least.append(model.flight_evidence(state))
    assert found.evidence == pytest.approx(min(least), rel=1e-9)
    assert min(least) < least[0]


@pytest.mark.parametrize("turn", [0.1, 2.1])
@pytest.mark.parametrize("error", WRONG)
def test_one_wrong_mean_current_makes_no_error_of_a_sound_flight_model(turn, error):
    given = dives(7, 0.0, turn=turn)
    assert not any(state.is_believed for state in after(given))
    for k in (0, 4):
        assert max(state.evidence for state in after(with_wrong(given, k, error))) < LEAST_EVIDENCE


@pytest.mark.parametrize("error", WRONG)
def test_one_wrong_mean_current_hardly_moves_an_error_that_is_known(error):
    given = dives(14, 0.5)
    plain, other = after(given)[-1], after(with_wrong(given, 9, error))[-1]
    assert plain.is_believed
    assert other.is_believed
    assert 0.22 * np.hypot(*(other.share[0] - plain.share[0])) < 0.01


def test_of_many_dives_those_are_left_out_without_which_the_evidence_is_least(monkeypatch):
    given = dives(8, 0.4)
    whole = after(given)[-1]
    monkeypatch.setattr(corrections, "_MOST_LEFT_OUT", 3)
    few = after(given)[-1]
    assert len(few.known.log_weights) == 1 + 3
    assert few.evidence == pytest.approx(whole.evidence, rel=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_errors_of_mean_currents_on_one_course_are_no_error_of_the_flight_model(seed):
    # each is in the way through the water too, so that ways and mean currents vary against each other
    given = dives(12, 0.0, seed, turn=0.0)
    for k, error in enumerate(0.02 * np.random.default_rng(seed).normal(size=(12, 2))):
        given = with_wrong(given, k, error)
    assert not any(state.is_believed for state in after(given))
