"""Errors of the instrument that no state stands for: whether the log is heard to speak of them."""

from dataclasses import replace

import numpy as np
import pytest

from replay_kit.config.estimation import TimeConfig
from replay_kit.config.run import EstimatorConfig
from replay_kit.core.geodesy import rotate_to_geographic, to_local
from replay_kit.core.grid import Ensemble
from replay_kit.estimator import build_estimator
from replay_kit.estimator.evolving.build import build_evolving
from replay_kit.estimator.prior.conditioned import is_matrix
from replay_kit.estimator.update import representation
from replay_kit.estimator.update.biases import (
    NAMES,
    Biases,
    BiasScore,
    bias_rows,
    in_words,
    scale_jacobian,
)
from replay_kit.estimator.update.gate import Spectrum, gate_innovations
from replay_kit.estimator.update.observation_space import ObservationSpacePosterior
from replay_kit.estimator.update.reduced_subspace import ReducedSubspacePosterior
from replay_kit.estimator.update.screening import relative_velocities
from replay_kit.studies.twins.adcp import random_observations
from replay_kit.studies.twins.field import build_field
from tests import synthetic
from tests.estimator.evolving.test_extras import faulty
from tests.estimator.update.test_path_mean import dive

LEVELS = np.array([5.0, 60.0, 150.0, 300.0])
ENSEMBLE = synthetic.ensemble(n_members=24, shape=(6, 7), levels=LEVELS)
OTHERS = Ensemble(ENSEMBLE.grid, ENSEMBLE.velocity[1:], None, "the others")
CONFIG = EstimatorConfig(modes=20, mean_variance=0.1)


def mission(heading, scale, n=110):
    """Profiles of member 0 from a vehicle that goes round, with an instrument's faults."""
    truth = Ensemble(ENSEMBLE.grid, ENSEMBLE.velocity[:1], None, "member 0")
    for k, profile in enumerate(random_observations(build_field(truth), n, 0.05, 7)):
        angle = 0.7 * k
        through_water = 0.3 * np.array([np.cos(angle), np.sin(angle)])
        yield faulty(replace(profile, time_ns=k), heading, scale, through_water, common_std=0.01)


def significant(estimator, log):
    *_, (state, _) = estimator.steps(estimator.initial(), log)
    return state.bias_score.significant()


@pytest.mark.parametrize("kind", ["static", pytest.param("evolving", marks=pytest.mark.full)])
def test_faults_are_named_with_their_size_and_a_sound_log_is_not_accused(kind):
    estimator = (
        build_estimator(OTHERS, CONFIG)
        if kind == "static"
        else build_evolving([OTHERS], CONFIG, TimeConfig())
    )
    assert significant(estimator, mission(0.0, 0.0)) == {}
    found = significant(estimator, mission(5.0, 0.06))
    assert set(found) == {"heading", "scale"}
    assert np.rad2deg(found["heading"][0]) == pytest.approx(5.0, abs=1.5)
    assert found["scale"][0] == pytest.approx(0.06, abs=0.02)
    assert set(significant(estimator, mission(-5.0, 0.0))) == {"heading"}
    assert significant(estimator, mission(-5.0, 0.0))["heading"][0] < 0.0


def compressed(rows, velocity):
    """What the rows make of velocities of the used bins."""
    stack = rows.stack
    return (stack.layouts[0].rows[:, stack.used[0]] @ velocity).T.ravel()


def test_the_evidence_is_the_score_of_a_gaussian_s_likelihood():
    """By differences of the log-likelihood of one profile in each error's size."""
    estimator = build_estimator(OTHERS, CONFIG)
    (profile,) = list(mission(3.0, 0.02, 1))
    used = np.arange(6)
    rows = estimator.rows(profile, used)
    innovation = rows.y - rows.matvec(estimator.prior.mean.reshape(LEVELS.size, -1))
    design = rows.design()
    cov = design @ estimator.prior.covariance() @ design.T + np.eye(len(design))
    units = rows.stack.bias_rows(np.zeros_like(rows.stack.values)).reshape(-1, len(NAMES))
    both = np.column_stack([innovation, units])
    evidence = BiasScore().updated(np.linalg.solve(np.linalg.cholesky(cov), both), 0.0)
    is_used = np.isin(np.arange(profile.depth.size), used)
    (relative,) = relative_velocities([profile.linear], is_used[None], ENSEMBLE.grid)
    for k, name in enumerate(NAMES):
        bias = Biases((name,), np.ones(1))
        column = np.hstack([bias.functions(profile.depth[used]) @ f for f in bias.factor(relative)])

        def log_likelihood(size, column=column):
            left = innovation - size * compressed(rows, column)
            return -0.5 * left @ np.linalg.inv(cov) @ left

        step = 1e-4
        slope = (log_likelihood(step) - log_likelihood(-step)) / (2 * step)
        bend = -(log_likelihood(step) + log_likelihood(-step) - 2 * log_likelihood(0.0)) / step**2
        assert evidence.score[k] == pytest.approx(slope, rel=1e-6, abs=1e-6)
        assert evidence.information[k, k] == pytest.approx(bend, rel=1e-4)


def test_a_shear_goes_along_the_way_through_the_water_expected_and_is_what_a_state_says_without_its_own():
    relative, innovation = np.array([[0.2, 0.0]]), np.array([[0.2, -0.3]])
    distance = np.array([0.0, 20.0, 60.0])
    along, measured = (
        bias_rows(np.ones((1, 3)), distance[None], relative, off)[0, ..., NAMES.index("shear")]
        for off in (innovation, 0.0 * innovation)
    )
    np.testing.assert_allclose(along, np.outer([0.0, -1.0], distance), atol=1e-12)
    of_state = Biases(("shear",), np.ones(1))
    column = of_state.functions(10.0 + distance) @ of_state.factor(relative[0])
    np.testing.assert_allclose(measured, column[..., 0])


def test_the_water_s_own_shear_is_no_error_of_the_instrument():
    """Profiles whose shear is the prior's alone, at random: along the way measured it would seem to be one."""
    estimator, rng = build_estimator(OTHERS, CONFIG), np.random.default_rng(5)
    (profile,) = list(mission(0.0, 0.0, 1))
    used, scores = np.arange(6), []
    for _ in range(400):
        velocity = profile.velocity.copy()
        velocity[used] += (
            2e-3 * rng.standard_normal(2) * (profile.depth[used] - profile.depth[0])[:, None]
        )
        sheared = replace(profile, velocity=velocity)
        rows = estimator.rows(sheared, used)
        innovation = rows.stack.values - estimator.rows(profile, used).stack.values
        pairs = [
            rows.stack.bias_rows(off).reshape(-1, len(NAMES))[:, 2]
            for off in (innovation, 0.0 * innovation)
        ]
        of_bins = compressed(rows, innovation[0, used])
        scores.append([column @ of_bins for column in pairs])
    mean, spread = np.mean(scores, axis=0), np.std(scores, axis=0) / np.sqrt(len(scores))
    assert abs(mean[0]) < 3.0 * spread[0]
    assert mean[1] < -10.0 * spread[1]


def test_through_time_the_evidence_is_what_a_state_with_a_flat_prior_says():
    name, flat = "heading", {"heading_bias_std": 5e4}
    off, on = (
        build_evolving([OTHERS], CONFIG, TimeConfig(scale=1e6, biases=names, **flat))
        for names in ((), (name,))
    )
    log = list(mission(4.0, 0.0, 12))
    (*_, (without, _)), (*_, (with_state, said)) = (
        off.steps(off.initial(), log),
        on.steps(on.initial(), log),
    )
    assert said.error_inflation == 1.0
    index = NAMES.index(name)
    information = without.bias_score.information[index, index]
    estimate, std = on.biases(with_state)[name]
    assert without.bias_score.score[index] / information == pytest.approx(estimate, rel=1e-4)
    assert 1.0 / np.sqrt(information) == pytest.approx(std, rel=1e-4)


@pytest.mark.parametrize("form", ["dual", "span", "dense", "with a mean current"])
def test_a_static_estimate_takes_off_what_the_current_absorbed_in_every_form(form, monkeypatch):
    """The same as the estimate through time that forgets nothing, whose answers lie in one matrix."""
    monkeypatch.setattr(representation, "_NEARLY_ALL", 0.75 if form == "dense" else 2.0)
    log = list(
        mission(4.0, 0.0, {"dual": 12, "span": 60, "dense": 60, "with a mean current": 20}[form])
    )
    if form == "span":
        log = [
            replace(one, longitude=log[k % 6].longitude, latitude=log[k % 6].latitude)
            for k, one in enumerate(log)
        ]
    if form == "with a mean current":
        log.insert(10, replace(dive(), time_ns=9))
    static, through = (
        build_estimator(OTHERS, CONFIG),
        build_evolving([OTHERS], CONFIG, TimeConfig(scale="static", dropped_std=0.0)),
    )
    (*_, (state, _)), (*_, (same, _)) = (
        static.steps(static.initial(), log),
        through.steps(through.initial(), log),
    )
    assert type(state.posterior) is (
        ReducedSubspacePosterior if form == "span" else ObservationSpacePosterior
    )
    assert is_matrix(state.posterior.prior) == (form in ("dense", "with a mean current"))
    np.testing.assert_allclose(state.bias_score.score, same.bias_score.score, rtol=1e-6)
    np.testing.assert_allclose(state.bias_score.information, same.bias_score.information, rtol=1e-6)


def test_the_stretch_is_the_slope_of_the_measure_of_what_is_logged():
    """A profile of one bin, with a platform known exactly: two components, so -2 log(1 + s); with a useless platform none."""
    estimator = build_estimator(OTHERS, CONFIG)
    (profile,) = list(mission(0.0, 0.0, 1))
    for common_std, expected in ((0.0, 2.0), (1e3, 0.0)):
        one = replace(profile, common_std=common_std)
        rows = estimator.rows(one, np.arange(1))
        # an innovation as large as its covariance says
        nothing = np.array([0.0]), np.array([0])
        spectrum = Spectrum.of(np.ones((1, 2)), np.zeros((1, 2, 2)))
        gates = gate_innovations(spectrum, np.array([2]), nothing, None)
        found = scale_jacobian(gates, np.ones(1), rows.stack.ones, np.array([common_std]))
        assert found == pytest.approx(expected, abs=1e-3)


@pytest.mark.full
def test_a_sound_log_gives_no_scale_error_on_the_average():
    """The regressor is made of what was measured: without the Jacobian it would find an error in its own noise."""
    estimator = build_evolving([OTHERS], CONFIG, TimeConfig(scale="static", biases=("scale",)))
    static = build_estimator(OTHERS, CONFIG)
    places = list(mission(0.0, 0.0, 40))
    z = []
    for seed in range(16):
        # a truth that the prior itself draws
        rng = np.random.default_rng(seed)
        weights = estimator.operator.process.weights(
            rng.standard_normal(estimator.operator.process.size), 0
        )
        truth = static.flow_of(weights.ravel(), np.empty((0, 0)), None)
        log = []
        for place in places:
            east, north = to_local(ENSEMBLE.grid.projection, place.longitude, place.latitude)
            local = truth.velocity(east, north, np.minimum(place.depth, 300.0))
            u, v = rotate_to_geographic(
                ENSEMBLE.grid.projection, place.longitude, place.latitude, *local.T
            )
            common = 0.03 * rng.standard_normal(2)
            platform = np.array(place.platform_velocity) + common
            velocity = np.column_stack([u, v]) + common + 0.05 * rng.standard_normal(local.shape)
            log.append(
                replace(
                    place,
                    velocity=velocity,
                    platform_velocity=(float(platform[0]), float(platform[1])),
                    common_std=0.03,
                )
            )
        *_, (state, _) = estimator.steps(estimator.initial(), log)
        estimate, std = estimator.biases(state)["scale"]
        z.append(estimate / std)
    assert abs(np.mean(z)) < 3.0 / np.sqrt(len(z))


def test_a_log_that_does_not_say_how_its_platform_moved_says_nothing_of_faults():
    estimator = build_estimator(OTHERS, CONFIG)
    log = [replace(profile, platform_velocity=None) for profile in mission(20.0, 0.2)]
    *_, (state, _) = estimator.steps(estimator.initial(), log)
    assert not state.bias_score.information.any()


def test_faults_in_words():
    assert in_words("heading", np.deg2rad(5.0), np.deg2rad(0.5)) == "heading +5.0 +- 0.5 degrees"
    assert in_words("scale", -0.031, 0.002) == "scale -3.1 +- 0.2 %"
    assert in_words("shear", 2e-4, 1e-5) == "shear +0.20 +- 0.01 mm/s a metre"


def test_stds_are_at_least_those_of_the_scatter_of_the_parts_for_so_many_parts_less_three_estimates():
    """White's covariance of the joint estimate, with the factor of few samples, part by part."""
    rng, errors, n = np.random.default_rng(3), np.array([0.3, 0.2, 1e-2]), 9
    roots = rng.standard_normal((n, 5, 3)) * [30.0, 50.0, 2e3]
    informations = np.stack([root.T @ root for root in roots])
    # a scatter of twenty times what a part's information says
    scores = informations @ errors + np.stack(
        [20.0 * root.T @ rng.standard_normal(5) for root in roots]
    )
    cov = np.linalg.inv(informations.sum(axis=0))
    joint = cov @ scores.sum(axis=0)
    residuals = [
        score - of_part @ joint for score, of_part in zip(scores, informations, strict=True)
    ]
    white = n / (n - 3) * cov @ sum(np.outer(residual, residual) for residual in residuals) @ cov
    found = BiasScore(scores, informations).significant()
    assert set(found) == set(NAMES)
    np.testing.assert_allclose(
        [found[name] for name in NAMES],
        np.column_stack([joint, np.sqrt(np.diag(white))]),
        rtol=1e-9,
    )
    # with a small scatter those of the information stay
    calm = BiasScore(informations @ errors, informations).significant()
    np.testing.assert_allclose([calm[name][1] for name in NAMES], np.sqrt(np.diag(cov)), rtol=1e-9)


def test_parts_of_a_log_have_equal_numbers_of_profiles_but_the_last_one_which_grows():
    score, one = BiasScore(), np.eye(3)
    whitened = np.column_stack([[1.0, 0.0, 2.0], one])
    for count in range(1, 200):
        score = score.updated(whitened, 0.5)
        numbers = score.informations[:, 0, 0]
        np.testing.assert_array_equal(score.informations, numbers[:, None, None] * one)
        np.testing.assert_array_equal(score.scores, numbers[:, None] * np.array([1.0, -0.5, 2.0]))
        assert numbers.sum() == count
        assert set(numbers[:-1]) <= {score.length}
        assert 1 <= numbers[-1] == score.last <= score.length
        # as many parts as may be, until they are joined in pairs
        assert min(count, 17) <= len(numbers) <= 32
