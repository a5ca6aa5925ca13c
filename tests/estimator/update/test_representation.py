"""The two forms of the posterior against the textbook update and each other; states that share buffers and never change.

| case | why the tolerance |
|---|---|
| mean 1e-8 of its norm, covariance 1e-6 of the prior's | directions are counted to 1e-10, and the covariance is a difference |
| branches, pickles: bit for bit | nothing but copies lies between them |
"""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.flow.factors import n_stored
from replay_kit.core.flow.functions import depth_weights
from replay_kit.estimator import FilterState, build_estimator
from replay_kit.estimator.prior.conditioned import FullCovariancePrior
from replay_kit.estimator.update import reduced_subspace, representation
from replay_kit.estimator.update.observation_space import ObservationSpacePosterior, initial
from replay_kit.estimator.update.posterior import directions, nonzero_mode_std
from replay_kit.estimator.update.reduced_subspace import (
    ReducedSubspacePosterior,
    to_reduced_subspace,
)
from replay_kit.estimator.update.representation import (
    PosteriorCovariance,
    select_representation,
    to_full_covariance,
)
from tests import synthetic
from tests.estimator.runs import assert_alike, run
from tests.reference import estimator as slow
from tests.reference.lattice import matrix as functions_at

LEVELS = np.array([5.0, 90.0, 220.0])
WORLD = synthetic.ensemble(n_members=9, shape=(5, 7), levels=LEVELS)
DEPTH = 10.0 + 20.0 * np.arange(11)
CONFIG = EstimatorConfig(length_vertical=60.0, modes=20, mean_variance=0.1)
ESTIMATORS = {
    name: build_estimator(WORLD, CONFIG.model_copy(update={"preset": name}))
    for name in ("default", "paper")
}


def observed(places, seed=0, depth=DEPTH, world=WORLD):
    rng = np.random.default_rng(seed)
    noise = 0.2 * rng.standard_normal((len(places), depth.size, 2))
    return [
        synthetic.profile(world.grid, *place, depth, v, time_ns=k)
        for k, (place, v) in enumerate(zip(places, noise, strict=True))
    ]


def places(kind, n):
    rng = np.random.default_rng(1)
    along = np.linspace(-1.0, 1.0, n)[:, None]
    return {
        "track": along * np.array([1.8e4, 1.2e4]) + 2e3 * np.sin(5.0 * along),
        "dense track": along * np.array([300.0, 200.0]),
        "repeated": np.tile(rng.uniform(-1.5e4, 1.5e4, (3, 2)), (n, 1))[:n],
        "scattered": rng.uniform(-1.0, 1.0, (n, 2)) * np.array([2.2e4, 1.6e4]),
    }[kind]


def textbook(estimator, observations, said, start=None):
    """Mean and covariance after observations, with the errors of the innovations ``said`` of them."""
    mean, cov = start or (estimator.prior.mean, estimator.prior.covariance())
    for observation, innovation in zip(observations, said, strict=True):
        rows = estimator.rows(observation, np.arange(observation.depth.size))
        design = np.vstack(
            [
                np.kron(
                    rows.stack.layouts[0].unwhiten @ rows.stack.layouts[0].q @ rows.r, rows.basis[c]
                )
                for c in range(2)
            ]
        )
        noise = np.diag(np.tile(rows.stack.layouts[0].std ** 2 * innovation.error_inflation, 2))
        mean, cov, _, _ = slow.kalman_update(
            mean, cov, design, rows.stack.values[0].T.ravel(), noise
        )
    return mean, cov


def assert_is(estimator, state, mean, cov):
    scale = np.abs(estimator.prior.covariance()).max()
    assert np.linalg.norm(state.mean - mean) < 1e-8 * np.linalg.norm(mean)
    np.testing.assert_allclose(state.posterior.covariance(), cov, atol=1e-6 * scale)


def standard_error(flow, east, north, depth):
    """Root of diag(H P H'), shape (n, 2), from one dense H."""
    rows = []
    for point in zip(east, north, depth, strict=True):
        kernel = functions_at(flow.horizontal, np.array([point[:2]]))
        weights = depth_weights(flow.depth_functions, np.array([point[2]]), flow.levels)
        rows.append([np.kron(weights[0], kernel[c] @ flow.modes) for c in range(2)])
    design = np.array(rows)
    return np.sqrt(np.einsum("pcn,nm,pcm->pc", design, flow.weight_cov, design))


@pytest.fixture
def spans_stay(monkeypatch):
    """Let a span form keep nearly all directions, which these small worlds soon have."""
    monkeypatch.setattr(representation, "_NEARLY_ALL", 1.0)


def as_span(state):
    """The same state in the span form, whatever the log."""
    dual = state.posterior
    std = nonzero_mode_std(dual.prior)
    return FilterState(
        to_reduced_subspace(dual, directions(dual.profile_basis * std), std), time_ns=state.time_ns
    )


@pytest.mark.parametrize("kind", ["scattered", "dense track"])
def test_nothing_measured_is_lost_when_room_for_directions_runs_out(kind, spans_stay, monkeypatch):
    monkeypatch.setattr(reduced_subspace, "_MORE", 1)
    monkeypatch.setattr(reduced_subspace, "_MORE_SHARE", 0.0)
    estimator, observations = ESTIMATORS["default"], observed(places(kind, 9))
    state, first = run(estimator, observations[:3])
    state, rest = run(estimator, observations[3:], as_span(state))
    assert isinstance(state.posterior, ReducedSubspacePosterior)
    assert state.posterior.room <= state.posterior.size + 1
    assert_is(
        estimator,
        state,
        *textbook(estimator, observations, first + rest),
    )


def checked_run(preset, kind, n):
    """The last state of a log, which is the textbook's."""
    estimator, observations = ESTIMATORS[preset], observed(places(kind, n))
    state, said = run(estimator, observations)
    assert_is(estimator, state, *textbook(estimator, observations, said))
    return state


@pytest.mark.parametrize("preset", ESTIMATORS)
@pytest.mark.parametrize("kind", ["track", "dense track", "repeated", "scattered"])
@pytest.mark.parametrize("n", [5, 33, 120])
def test_any_log_gives_the_textbook_s_posterior(preset, kind, n):
    checked_run(preset, kind, n)


@pytest.mark.parametrize("switch", [1, 2, 7, 11])
@pytest.mark.usefixtures("spans_stay")
def test_the_form_may_change_after_any_ping(switch):
    estimator = ESTIMATORS["default"]
    observations = observed(places("track", 12))
    state, _ = run(estimator, observations[:switch])
    expected, expected_said = run(estimator, observations)
    assert isinstance(expected.posterior, ObservationSpacePosterior)
    other, said = run(estimator, observations[switch:], as_span(state))
    assert isinstance(other.posterior, ReducedSubspacePosterior)
    assert_is(estimator, other, expected.mean, expected.posterior.covariance())
    assert_alike(said, expected_said[switch:], 1e-7, 1e-9)


@pytest.mark.parametrize("preset", ESTIMATORS)
@pytest.mark.full
def test_hundreds_of_pings_need_no_more_than_the_covariance(preset):
    assert checked_run(preset, "track", 600).posterior.n_rows <= 1024 + 6


def test_rows_in_few_directions_take_the_span_form_and_more_than_the_weights_begin_anew():
    estimator = ESTIMATORS["default"]
    assert isinstance(
        run(estimator, observed(places("scattered", 12)))[0].posterior, ObservationSpacePosterior
    )
    assert isinstance(
        run(estimator, observed(places("repeated", 13)))[0].posterior, ReducedSubspacePosterior
    )  # 78 rows, 60 weights
    everywhere = run(estimator, observed(places("scattered", 13)))[0].posterior
    assert isinstance(everywhere.prior, FullCovariancePrior)
    assert everywhere.n_rows == 0
    many = build_estimator(
        synthetic.ensemble(n_members=40, shape=(8, 9), levels=LEVELS),
        EstimatorConfig(modes=None, mean_variance=0.1),
    )
    observations = observed(places("repeated", 40))
    assert isinstance(run(many, observations[:31])[0].posterior, ObservationSpacePosterior)
    assert isinstance(run(many, observations)[0].posterior, ReducedSubspacePosterior)
    assert isinstance(
        run(many, observed(places("scattered", 33)))[0].posterior, ObservationSpacePosterior
    )
    assert (
        select_representation(initial(many.prior, np.zeros((3, 3, many.prior.mean.size // 3)))).n
        == 0
    )


@pytest.mark.parametrize("preset", ESTIMATORS)
@pytest.mark.parametrize("kind", ["track", "repeated", "scattered"])
def test_blocks_give_what_single_steps_give(preset, kind):
    estimator = ESTIMATORS[preset]
    observations = observed(places(kind, 75))
    observations[5] = replace(
        observations[5], flags=np.full(DEPTH.size, 4, dtype=np.int8)
    )  # nothing of it is used
    one_by_one, said = [estimator.initial()], []
    for observation in observations:
        state, innovation = estimator.step(one_by_one[-1], observation)
        one_by_one.append(state)
        said.append(innovation)
    in_blocks = list(estimator.steps(estimator.initial(), iter(observations)))
    assert (
        [i.accepted for _, i in in_blocks]
        == [i.accepted for i in said]
        == [k != 5 for k in range(75)]
    )
    means = estimator.weights([state for state, _ in in_blocks])
    for mean, (state, innovation), alone, expected in zip(
        means, in_blocks, one_by_one[1:], said, strict=True
    ):
        tolerance = 1e-8 * np.linalg.norm(alone.mean)
        assert np.linalg.norm(mean - alone.mean) < tolerance
        assert np.linalg.norm(mean - state.mean) < tolerance
        assert innovation.nis == pytest.approx(expected.nis, rel=1e-6, nan_ok=True)
        np.testing.assert_allclose(
            innovation.prior_innovation, expected.prior_innovation, atol=1e-12
        )


def test_what_is_folded_into_the_prior_is_kept():
    estimator = ESTIMATORS["default"]
    first, second = observed(places("scattered", 9)), observed(places("track", 5), seed=4)
    expected, _ = run(estimator, [*first, *second])
    for state in (run(estimator, first)[0], as_span(run(estimator, first)[0])):
        new = to_full_covariance(state.posterior)
        assert new.n_rows == 0
        np.testing.assert_allclose(new.mean, state.mean, atol=1e-12)
        again = to_full_covariance(run(estimator, second, FilterState(new))[0].posterior)
        assert_is(estimator, FilterState(again), expected.mean, expected.posterior.covariance())


@pytest.mark.parametrize("form", ["dual", "span"])
@pytest.mark.usefixtures("spans_stay")
def test_a_state_never_changes_and_branches_are_independent(form):
    estimator = ESTIMATORS["default"]
    first, second = observed(places("scattered", 20)), observed(places("track", 20), seed=5)
    state, _ = run(estimator, first[:6])
    if form == "span":
        state = as_span(state)
    before = state.mean.copy(), state.posterior.covariance()
    states = [state]
    for observation in first[6:]:
        states.append(estimator.step(states[-1], observation)[0])
    means = [(s.mean.copy(), s.posterior.covariance()) for s in states]
    fresh, _ = run(estimator, second, pickle.loads(pickle.dumps(state)))
    branch, _ = run(estimator, second, state)
    np.testing.assert_array_equal(branch.mean, fresh.mean)
    twice, _ = run(estimator, second, states[3])
    assert np.any(twice.mean != branch.mean)
    for (mean, cov), old in zip(means, states, strict=True):
        again = pickle.loads(pickle.dumps(old.posterior))
        again.__dict__.pop("mean", None)
        np.testing.assert_array_equal(again.mean, mean)
        np.testing.assert_array_equal(old.posterior.covariance(), cov)
    np.testing.assert_array_equal(before[0], states[0].mean)
    np.testing.assert_array_equal(before[1], states[0].posterior.covariance())
    redone, _ = run(estimator, first[6:], states[0])
    np.testing.assert_array_equal(redone.mean, states[-1].mean)


@pytest.mark.parametrize("form", ["dual", "span"])
def test_inflated_errors_count_once_and_less(form):
    estimator = ESTIMATORS["default"]
    smooth = synthetic.wiggle(WORLD.grid)
    earlier = observed(places("scattered", 4))
    state, said = run(estimator, earlier)
    after, innovation = estimator.step(as_span(state) if form == "span" else state, smooth)
    assert innovation.error_inflation > 2.0
    said = (*said, innovation)
    assert_is(estimator, after, *textbook(estimator, [*earlier, smooth], said))


def test_profiles_of_few_bins_among_full_ones():
    estimator = ESTIMATORS["default"]
    where = places("scattered", 40)
    observations = [
        observation
        for k, place in enumerate(where)
        for observation in observed(
            place[None], k, DEPTH[3:4] if k % 3 == 0 else DEPTH[4:6] if k % 3 == 1 else DEPTH
        )
    ]
    state, said = run(estimator, observations)
    assert_is(estimator, state, *textbook(estimator, observations, said))


def test_modes_without_prior_variance_harm_nothing():
    estimator = ESTIMATORS["paper"]
    variance = estimator.prior.variance.copy()
    variance[:, 5] = 0.0
    without = replace(estimator, prior=replace(estimator.prior, variance=variance))
    observations = observed(places("track", 40))
    state, said = run(without, observations)
    assert_is(without, state, *textbook(without, observations, said))


@pytest.mark.parametrize("preset", ESTIMATORS)
def test_the_modes_scale_is_the_root_mean_square_of_the_prior_s_diagonal(preset):
    prior = ESTIMATORS[preset].prior
    expected = np.sqrt(np.diag(prior.covariance()).reshape(3, -1).mean(axis=0))
    np.testing.assert_allclose(nonzero_mode_std(prior), expected, rtol=1e-12)


def test_a_flow_computes_its_covariance_once_and_carries_it_when_pickled():
    estimator = ESTIMATORS["default"]
    state, _ = run(estimator, observed(places("scattered", 4)))
    flow = estimator.flow(state)
    assert flow.weight_cov is flow.weight_cov
    later, _ = run(estimator, observed(places("track", 9)), state)
    copy = pickle.loads(pickle.dumps(estimator.flow(state)))
    assert isinstance(copy.covariance, np.ndarray)
    np.testing.assert_array_equal(copy.weight_cov, flow.weight_cov)
    assert later.time_ns == 8
    with pytest.raises(Exception, match="carries none"):
        flow.mean_flow().standard_error(0.0, 0.0, 5.0)


def test_standard_errors_of_points_that_share_places_are_diag_hph():
    estimator = ESTIMATORS["paper"]
    flow = estimator.flow(run(estimator, observed(places("scattered", 4)))[0])
    rng = np.random.default_rng(2)
    where = np.repeat(rng.uniform(-1.5e4, 1.5e4, (5, 2)), 4, axis=0)
    depth = rng.uniform(0.0, 220.0, 20)
    order = rng.permutation(20)
    east, north, depth = where[order, 0], where[order, 1], depth[order]
    expected = standard_error(flow, east, north, depth)
    np.testing.assert_allclose(flow.standard_error(east, north, depth), expected, rtol=1e-10)
    one_by_one = [flow.velocity(*point) for point in zip(east, north, depth, strict=True)]
    np.testing.assert_allclose(flow.velocity(east, north, depth), one_by_one, atol=1e-12)


@pytest.mark.parametrize("form", ["rows", "span", "matrix"])
def test_an_inflated_posterior_keeps_its_form_and_goes_on_as_the_textbook_s(form):
    estimator = ESTIMATORS["default"]
    observations = observed(places("track", 9))
    state, said = run(estimator, observations[:6])
    mean, cov = textbook(estimator, observations[:6], said)
    if form != "rows":
        state = (
            as_span(state)
            if form == "span"
            else FilterState(to_full_covariance(state.posterior), time_ns=state.time_ns)
        )
    bias = state.posterior.bias_sensitivity()
    for factor in (2.5, 1.2):
        larger = representation.inflated(state.posterior, factor)
        assert type(larger) is type(state.posterior)
        state, cov = replace(state, posterior=larger), factor * cov
    assert_is(estimator, state, mean, cov)
    np.testing.assert_allclose(
        state.posterior.bias_sensitivity(), bias, rtol=1e-7, atol=1e-9 * np.abs(bias).max()
    )
    state, said = run(estimator, observations[6:], state)
    assert_is(estimator, state, *textbook(estimator, observations[6:], said, (mean, cov)))


def test_with_many_weights_no_matrix_of_them_is_made(monkeypatch):
    monkeypatch.setattr(representation, "_LARGE", 10)
    state = checked_run("default", "scattered", 40)
    assert isinstance(state.posterior, ReducedSubspacePosterior)


def test_the_factors_of_an_estimate_are_its_covariance():
    # few members and pings in many modes: the factors are fewer numbers than half of the matrix
    many = build_estimator(
        synthetic.ensemble(n_members=4, shape=(8, 9), levels=np.linspace(5.0, 220.0, 12)),
        EstimatorConfig(modes=40, mean_variance=0.1),
    )
    state, _ = run(many, observed(places("dense track", 2)))
    for posterior in (
        state.posterior,
        as_span(state).posterior,
        representation.inflated(state.posterior, 2.0),
    ):
        factors = PosteriorCovariance(posterior).factors()
        assert factors is not None
        expected = posterior.covariance()
        assert n_stored(factors.prior, len(factors.directions)) < expected.size / 2
        np.testing.assert_allclose(factors(None), expected, atol=1e-9 * np.abs(expected).max())
        np.testing.assert_allclose(
            factors.of_sum((0, 3)),
            PosteriorCovariance(posterior).of_sum((0, 3)),
            atol=1e-9 * np.abs(expected).max(),
        )
