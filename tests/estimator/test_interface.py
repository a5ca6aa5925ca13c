"""Every estimator, baselines included, against the one interface."""

from dataclasses import replace
from inspect import isfunction

import numpy as np
import pytest

from replay_kit.config.estimation import TimeConfig
from replay_kit.config.run import EstimatorConfig
from replay_kit.core.errors import EstimatorError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.observation import Flag, Reason
from replay_kit.estimator import Estimator, build_estimator
from replay_kit.estimator.baselines.builders import BASELINES, build_baseline
from replay_kit.estimator.evolving.build import build_evolving
from tests import synthetic
from tests.estimator.update.test_path_mean import dive

ENSEMBLE = synthetic.ensemble(n_members=8, shape=(5, 6), levels=np.array([5.0, 60.0, 150.0]))
CONFIG = EstimatorConfig(modes=10, sample_share=0.6)
DEPTH = np.array([10.0, 30.0, 90.0])
OWN = ("default", "paper", "evolving")
MEMBERS = sorted(
    name
    for name, value in vars(Estimator).items()
    if not name.startswith("_") and (isfunction(value) or isinstance(value, property))
)


def built(name):
    if name == "evolving":
        return build_evolving([ENSEMBLE], CONFIG, TimeConfig(scale=86_400.0))
    if name in OWN:
        return build_estimator(ENSEMBLE, CONFIG.model_copy(update={"preset": name}))
    return build_baseline(name, ENSEMBLE, CONFIG)


def profile(place=(1e3, 2e3), time_ns=10, level=0.3):
    return synthetic.profile(ENSEMBLE.grid, *place, DEPTH, np.full((3, 2), level), time_ns=time_ns)


@pytest.fixture(scope="module", params=[*OWN, *BASELINES])
def estimator(request):
    return built(request.param)


def test_it_declares_every_member_of_the_interface(estimator):
    assert len(MEMBERS) >= 12
    assert all(hasattr(type(estimator), name) for name in MEMBERS)
    assert type(estimator).supports_path_means in (True, False)
    assert type(estimator).block_size >= 1
    assert estimator.state_size > 0


@pytest.mark.parametrize("name", ["default", "paper", "evolving", "naive3d"])
def test_the_prior_alone_is_common_to_all_states(name):
    estimator = built(name)
    assert estimator.common_part is (estimator.prior if name in ("default", "paper") else None)


def test_steps_are_repeated_steps_and_states_do_not_change(estimator):
    log = [profile(), profile((-4e3, 1e3), 20), profile((5e3, -3e3), 30)]
    start = estimator.initial()
    before = estimator.flow(start).latent.copy()
    state, innovations = start, []
    for observation in log:
        assert estimator.usable(observation)
        state, innovation = estimator.step(state, observation)
        innovations.append(innovation)
    *_, (same, last) = estimator.steps(start, log)
    np.testing.assert_allclose(estimator.flow(same).latent, estimator.flow(state).latent, atol=1e-9)
    np.testing.assert_allclose(last.innovation, innovations[-1].innovation, atol=1e-9)
    np.testing.assert_array_equal(estimator.flow(start).latent, before)
    assert all(innovation.accepted for innovation in innovations)


def test_the_innovation_is_that_of_the_step_without_assimilation(estimator):
    state, _ = estimator.step(estimator.initial(), profile())
    later = profile((-4e3, 1e3), 20)
    np.testing.assert_allclose(
        estimator.innovation(state, later), estimator.step(state, later)[1].innovation, atol=1e-12
    )


def test_a_prediction_of_an_earlier_or_the_same_time_changes_nothing(estimator):
    state, _ = estimator.step(estimator.initial(), profile())
    for time_ns in (5, 10):
        flow = estimator.flow(estimator.predict(state, time_ns))
        assert isinstance(flow, FlowEstimate)
        np.testing.assert_array_equal(flow.latent, estimator.flow(state).latent)


def test_weights_are_those_of_each_state_or_none(estimator):
    states = [
        state
        for state, _ in estimator.steps(estimator.initial(), [profile(), profile((-4e3, 1e3), 20)])
    ]
    weights = estimator.weights(states)
    assert len(weights) == 2
    assert all(of_state is None or of_state.ndim == 1 for of_state in weights)
    assert list(estimator.weights([])) == []


def test_notes_are_lines_of_text(estimator):
    state, _ = estimator.step(estimator.initial(), profile())
    assert all(isinstance(note, str) for note in [*estimator.notes(), *estimator.bias_notes(state)])


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"depth": np.array([400.0, 500.0, 600.0])}, Reason.BELOW_GRID),
        ({"longitude": 160.0}, Reason.OUTSIDE_REGION),
        ({"flags": np.full(3, Flag.MISSING, np.int8)}, Reason.NONE),
    ],
)
def test_an_unusable_profile_is_so_for_every_member(estimator, changes, reason):
    dry = replace(profile(), **changes)
    state = estimator.initial()
    after, innovation = estimator.step(state, dry)
    assert after is state
    assert not innovation.accepted
    assert innovation.dof == 0
    assert innovation.reasons.tolist() == [reason] * 3
    assert not estimator.usable(dry)
    assert np.isnan(estimator.innovation(state, dry)).all()
    assert np.isnan(innovation.log_likelihood)


@pytest.mark.parametrize("name", ["default", "evolving", "naive3d"])
def test_the_log_likelihood_is_that_of_the_innovation_s_gaussian(name):
    """Errors far above the prior's make all values independent, and two measurements with one prediction differ by their NIS alone."""
    estimator = built(name)
    vague = replace(profile(level=40.0), error_std=np.full(3, 50.0))
    far, near = (
        estimator.step(estimator.initial(), replace(vague, velocity=scale * vague.velocity))[1]
        for scale in (1.0, 0.0)
    )
    z = far.innovation / far.innovation_std
    assert far.log_likelihood == pytest.approx(
        -0.5 * np.sum(z**2) - np.sum(np.log(far.innovation_std)), rel=1e-3
    )
    assert far.log_likelihood - near.log_likelihood == pytest.approx(
        -0.5 * (far.nis - near.nis), rel=1e-9
    )


@pytest.mark.parametrize("name", [*OWN, *BASELINES])
def test_means_along_a_path_are_assimilated_or_refused_as_declared(name):
    estimator = built(name)
    if estimator.supports_path_means:
        _, innovation = estimator.step(estimator.initial(), dive())
        assert innovation.dof == 2
    else:
        with pytest.raises(EstimatorError, match="supports_path_means"):
            estimator.step(estimator.initial(), dive())


def test_no_flow_in_the_span_is_nearer_than_the_span_s_residual_says(estimator):
    points, depth = ENSEMBLE.grid.nodes[::3], np.full(len(ENSEMBLE.grid.nodes[::3]), 60.0)
    velocity = estimator.flow(estimator.initial()).velocity(points[:, 0], points[:, 1], depth)
    residual = estimator.span_residual(points, depth, velocity)
    if residual is not None:
        # an estimate of its own is in the span: the least-squares fit recovers it
        np.testing.assert_allclose(residual, 0.0, atol=1e-6)
