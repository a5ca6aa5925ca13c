"""Profiles combined before they meet the filter: what they say one after another, and each still judged on its own."""

from dataclasses import replace

import numpy as np
import pytest

from replay_kit.config.estimation import GatingConfig, TimeConfig
from replay_kit.core.observation import Flag, Reason
from replay_kit.estimator import build_estimator
from replay_kit.estimator.evolving.build import build_evolving
from replay_kit.estimator.static.group import profiles_of
from replay_kit.estimator.update.gate import DECISIONS, Spectrum
from replay_kit.estimator.update.grouping import Grouping, ProfileGroup
from replay_kit.estimator.update.noise import dependence_inflation
from replay_kit.estimator.update.reduced_subspace import Buffer
from replay_kit.estimator.update.screening import screen_group
from replay_kit.estimator.update.superobservation import (
    Column,
    Judging,
    combined,
    evaluate_group,
    gate_profiles,
)
from replay_kit.workflows.replay.inputs.estimator import with_window
from replay_kit.workflows.replay.stages.estimation import EstimationState, assimilate
from tests.estimator.evolving.test_evolving import CONFIG, DAY, forecasts, profiles
from tests.estimator.runs import after, rows_of
from tests.estimator.update.test_gate import gate_innovation

SECOND = 10**9
ENSEMBLE = forecasts(1)[0]


def quick_log(n=20, *, moving=0.0, deepening=0.0, dropouts=0.0, seed=4, noise=0.05):
    """Profiles at 1 Hz under one place, or along a short way, sinking, with bins missing here and there."""
    start = profiles(1)[0]
    rng, log = np.random.default_rng(seed), []
    for k in range(n):
        flags = np.where(rng.random(start.depth.size) < dropouts, Flag.FAIL, Flag.GOOD).astype(
            np.int8
        )
        velocity = start.velocity + noise * rng.standard_normal(start.velocity.shape)
        # what is not a number must not be reckoned with
        velocity[flags == Flag.FAIL] = np.nan if k % 2 else np.inf
        place = {"longitude": start.longitude + moving * k, "depth": start.depth + deepening * k}
        log.append(
            replace(start, time_ns=DAY + k * SECOND, velocity=velocity, flags=flags, **place)
        )
    return log


def stated(log):
    """The same with the platform's velocity, which turns."""
    turns = np.linspace(0.0, 2.0, len(log))
    return [
        replace(p, platform_velocity=(np.cos(a), np.sin(a)), common_std=0.02)
        for p, a in zip(log, turns, strict=True)
    ]


def unstated(log):
    """The same relative to a platform of unknown velocity."""
    return [replace(p, reference="platform", common_std=np.inf) for p in log]


def joint(estimator, log):
    *_, last = estimator.group_steps(estimator.initial(), [ProfileGroup(tuple(log))])
    return last


KINDS = {"plain": lambda log: log, "stated": stated, "relative": unstated}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("dropouts", [0.0, 0.3])
def test_profiles_under_one_place_say_together_what_they_say_alone(kind, dropouts):
    """Bins sink and are missing, but the place is one: the update is exact."""
    log = KINDS[kind](quick_log(dropouts=dropouts, deepening=0.7))
    estimator = build_estimator(ENSEMBLE, CONFIG)
    state, together = after(estimator, log), joint(estimator, log)
    inflation = {i.error_inflation for _, i in estimator.steps(estimator.initial(), log)}
    assert inflation == {1.0}, "errors that adapt differ a little"
    assert together.innovation.profiles == len(log)
    np.testing.assert_allclose(
        together.after.mean, state.mean, atol=1e-8 * np.abs(state.mean).max()
    )
    cov, expected = together.after.posterior.covariance(), state.posterior.covariance()
    np.testing.assert_allclose(cov, expected, atol=1e-8 * np.abs(expected).max())
    # the direction of a shear error is that of the motion through the water predicted at each profile's turn
    found, wanted = (each.posterior.bias_sensitivity()[:2] for each in (together.after, state))
    np.testing.assert_allclose(found, wanted, atol=1e-7 * max(np.abs(wanted).max(), 1e-3))
    assert together.innovation.log_likelihood == pytest.approx(
        sum(i.log_likelihood for _, i in estimator.steps(estimator.initial(), log)), rel=1e-9
    )


def test_the_innovation_of_a_group_errs_by_the_estimate_s_error_once_and_by_the_mean_of_its_profiles_noise():
    log = [
        replace(each, error_std=(1.0 + k) * each.error_std)
        for k, each in enumerate(quick_log(5, dropouts=0.3))
    ]
    estimator = build_estimator(ENSEMBLE, CONFIG)
    noise, of_estimate = [], []
    for profile in log:
        _, alone = estimator.step(estimator.initial(), profile)
        std = np.full(profile.depth.size, np.nan)
        used = np.flatnonzero(np.isfinite(alone.innovation_std[:, 0]))
        std[used] = estimator.noise(profile.linear, used).std
        noise.append(std)
        of_estimate.append(alone.innovation_std**2 - std[:, None] ** 2)
    seen = np.flatnonzero(np.isfinite(noise).any(axis=0))
    found = joint(estimator, log).innovation.innovation_std
    assert np.isnan(np.delete(found, seen, axis=0)).all()
    for k in seen:
        of_profiles = [std[k] for std in noise if np.isfinite(std[k])]
        expected = (
            np.nanmean([variance[k] for variance in of_estimate], axis=0)
            + np.sum(np.square(of_profiles)) / len(of_profiles) ** 2
        )
        np.testing.assert_allclose(found[k], np.sqrt(expected), rtol=1e-9)


@pytest.mark.parametrize("oscillators", [(), ("inertial",)])
def test_through_time_too(oscillators):
    log = quick_log(deepening=0.5, dropouts=0.2)
    time = TimeConfig(scale="static", oscillators=oscillators, oscillator_scale=1e9)
    estimator = build_evolving(forecasts(), CONFIG, time)
    # at one time, so that nothing but the grouping differs
    log = [replace(each, time_ns=DAY) for each in log]
    state, together = after(estimator, log), joint(estimator, log)
    np.testing.assert_allclose(
        together.after.mean, state.mean, atol=1e-8 * np.abs(state.mean).max()
    )
    np.testing.assert_allclose(together.after.cov, state.cov, atol=1e-8)
    assert together.after.time_ns == DAY


@pytest.mark.parametrize("kind", ["plain", "stated"])
@pytest.mark.parametrize("through_time", [False, True])
def test_what_a_group_differs_by_from_a_state_is_what_each_of_its_profiles_does(kind, through_time):
    log = KINDS[kind](quick_log(6, deepening=0.5, dropouts=0.3))
    estimator = (
        build_evolving(forecasts(), CONFIG, TimeConfig(scale=36e3))
        if through_time
        else build_estimator(ENSEMBLE, CONFIG)
    )
    state, _ = estimator.step(estimator.initial(), replace(log[0], time_ns=DAY - 7200 * SECOND))
    # at one time, as the group counts at one
    log = [replace(each, time_ns=DAY) for each in log]
    alone = np.concatenate([estimator.innovation(state, each) for each in log])
    together = estimator.group_innovation(state, ProfileGroup(tuple(log)))
    np.testing.assert_allclose(together, np.nan_to_num(alone), atol=1e-9)
    assert np.isnan(alone).any()
    *_, last = estimator.group_steps(state, [ProfileGroup(tuple(log))])
    assert last.against is not None
    assert len(last.event.profiles) == len(log)
    np.testing.assert_array_equal(last.against(state), together)


def test_biases_in_the_state_are_estimated_from_groups():
    log = stated(quick_log(60, noise=0.01))
    log = [
        replace(each, velocity=each.velocity + 0.05 * (each.velocity - each.platform_velocity))
        for each in log
    ]
    estimator = build_evolving(forecasts(), CONFIG, TimeConfig(biases=("scale",)))
    state = estimator.initial()
    for begin in range(0, len(log), 5):
        *_, last = estimator.group_steps(state, [ProfileGroup(tuple(log[begin : begin + 5]))])
        state = last.after
    alone = after(estimator, log)
    (mean, std), (expected, _) = estimator.biases(state)["scale"], estimator.biases(alone)["scale"]
    assert abs(mean - expected) < 0.3 * std


def column_and_stack(log):
    """A column of the estimate, and profiles as arrays."""
    estimator = build_estimator(ENSEMBLE, CONFIG)
    levels = ENSEMBLE.grid.levels
    stack = profiles_of(estimator, screen_group(log, None, ENSEMBLE.grid)).stack
    root = 0.1 * np.random.default_rng(1).standard_normal((2 * levels.size, 2 * levels.size))
    return Column(np.zeros((2 * levels.size, 4)), root @ root.T), stack


def odd_log(dropouts):
    """Profiles of which one is wrong as a whole, one scatters, and one errs alike in neighbouring bins."""
    log = quick_log(24, dropouts=dropouts)
    rng = np.random.default_rng(0)
    log[5] = replace(log[5], velocity=log[5].velocity + 3.0)
    log[6] = replace(
        log[6], velocity=log[6].velocity + 0.3 * rng.standard_normal(log[6].velocity.shape)
    )
    smooth = np.cumsum(rng.standard_normal(log[7].velocity.shape), axis=0)
    log[7] = replace(log[7], velocity=log[7].velocity + 0.05 * smooth)
    return log


@pytest.mark.parametrize("is_consistent", [True, False])
@pytest.mark.parametrize("gate", ["reject", "soften", "off", None])
@pytest.mark.parametrize("dropouts", [0.0, 0.3])
def test_the_gate_of_many_is_that_of_each(gate, is_consistent, dropouts):
    log = odd_log(dropouts)
    config = None if gate is None else GatingConfig(gate=gate)
    column, stack = column_and_stack(log)
    predicted = column.predicted(stack.of("r"))[..., 0]
    cov = column.predicted_cov(stack.of("r"))
    spectrum = Spectrum.of((stack.y - predicted).reshape(len(log), -1), cov)
    found = gate_profiles(stack, predicted, spectrum, Judging(config, True, is_consistent))
    seen = set()
    for i in range(len(log)):
        part = stack.part(np.array([i]))
        layout = part.layouts[0]
        r = layout.r[: layout.k]
        design = np.kron(np.eye(2), r)
        cov = design @ column.cov @ design.T
        innovation = (
            np.concatenate([part.y[0, c, : layout.k] for c in range(2)])
            - design @ column.means[:, 0]
        )
        square = float(np.sum((layout.whiten @ part.values[0]) ** 2) - np.sum(part.y[0] ** 2))
        single = gate_innovation(
            innovation, cov, (square, layout.dof - innovation.size), config, is_consistent
        )
        seen.add(single.decision)
        assert DECISIONS[found.decision[i]] == single.decision
        assert found.statistic[i] == pytest.approx(single.statistic)
        assert found.threshold[i] == pytest.approx(single.threshold)
        assert found.exceeds[i] == single.exceeds
        nis = innovation @ np.linalg.solve(cov + np.eye(innovation.size), innovation) + square
        assert found.nis[i] + stack.residual_square[i] == pytest.approx(nis)
        if single.decision == "rejected":
            continue
        mean = (
            cov @ np.linalg.solve(cov + single.error_factor * np.eye(len(cov)), innovation)
            + design @ column.means[:, 0]
        )
        known = layout.dof // 2
        left = (layout.whiten @ part.values[0])[:known] - layout.q[
            :known, : layout.k
        ] @ mean.reshape(2, -1).T
        left = left / np.sqrt(single.error_factor)
        further = dependence_inflation(left[None], np.array([left.size]))
        assert found.error_factor[i] == pytest.approx(single.error_factor * further)
    assert len(seen) == (2 if gate in ("reject", "soften") else 1)


def test_rows_of_one_layout_are_combined_as_those_of_several():
    rng = np.random.default_rng(0)
    r, y, weight = (
        np.triu(rng.standard_normal((4, 4))),
        rng.standard_normal((7, 2, 4, 3)),
        rng.uniform(0.2, 1.0, 7),
    )
    for rows in (r[None], np.broadcast_to(r, (7, 4, 4))):
        whole = combined(rows, y, weight)
        np.testing.assert_allclose(whole.r.T @ whole.r, weight.sum() * r.T @ r)
        np.testing.assert_allclose(
            np.einsum("kz,ckb->czb", whole.r, whole.y), np.einsum("s,kz,sckb->czb", weight, r, y)
        )
        square = np.sum(weight[:, None, None] * y[..., 0] ** 2) - np.sum(whole.y[..., 0] ** 2)
        assert whole.residual == pytest.approx(square)


@pytest.mark.parametrize("is_consistent", [True, False])
def test_profiles_of_one_layout_are_judged_at_once_as_in_turn(is_consistent):
    column, stack = column_and_stack(odd_log(0.0))
    assert len(stack.layouts) == 1
    judging = Judging(GatingConfig(), True, is_consistent)
    several = replace(stack, layouts=2 * stack.layouts, layout=np.arange(24) % 2)
    found, expected = (evaluate_group(each, column, judging) for each in (stack, several))
    decision = expected.gate.decision
    np.testing.assert_array_equal(found.gate.decision, decision)
    assert set(decision.tolist()) == ({0, 2} if is_consistent else {0, 1})
    assert np.count_nonzero(expected.gate.error_factor != 1.0) > 1
    for of in (
        lambda each: each.gate.statistic,
        lambda each: each.gate.error_factor,
        lambda each: each.before,
        lambda each: each.step.after.means,
        lambda each: each.step.after.cov,
        lambda each: each.step.rows.residual,
    ):
        np.testing.assert_allclose(of(found), of(expected), rtol=1e-11, atol=1e-13)


@pytest.mark.parametrize("through_time", [False, True])
def test_a_bad_profile_is_rejected_alone(through_time):
    gating = GatingConfig()
    estimator = (
        build_evolving(forecasts(), CONFIG, TimeConfig(), gating)
        if through_time
        else build_estimator(ENSEMBLE, CONFIG, gating)
    )
    # one of a group is told the monitor, so it takes five groups until the gate rejects
    log = quick_log(80)
    state, said = estimator.initial(), []
    log[45] = replace(log[45], velocity=log[45].velocity + 3.0)
    log[77] = replace(log[77], velocity=log[77].velocity + 3.0)
    log[78] = replace(
        log[78],
        velocity=np.full_like(log[78].velocity, np.nan),
        flags=np.full(log[78].flags.size, Flag.MISSING, np.int8),
    )
    clean = state
    for begin in range(0, 80, 8):
        group = log[begin : begin + 8]
        found = list(estimator.group_steps(state, [ProfileGroup(tuple(group))]))
        state = found[-1].after
        said += found
        kept = [p for k, p in enumerate(group, start=begin) if k not in (45, 77, 78)]
        *_, last = estimator.group_steps(clean, [ProfileGroup(tuple(kept))])
        clean = last.after
    others = [step for step in said if step.innovation.profiles == 1]
    assert [
        (step.event.time_ns - DAY) // SECOND
        for step in others
        if step.innovation.decision == "rejected"
    ] == [45, 77]
    assert [
        (step.event.time_ns - DAY) // SECOND
        for step in others
        if step.innovation.decision == "unusable"
    ] == [78]
    assert [step.innovation.profiles for step in said if step.innovation.profiles > 1][-1] == 6
    # a group counts for the mean time of all its profiles, half a second off here
    tolerance = 1e-4 if through_time else 1e-9
    np.testing.assert_allclose(state.mean, clean.mean, atol=tolerance * np.abs(clean.mean).max())


def test_of_a_group_with_one_profile_that_can_be_used_each_is_told_in_turn():
    estimator = build_evolving(forecasts(), CONFIG, TimeConfig())
    sound, lost = quick_log(2)
    lost = replace(lost, flags=np.full(lost.flags.size, Flag.MISSING, np.int8))
    found = list(estimator.group_steps(estimator.initial(), [ProfileGroup((sound, lost))]))
    assert [step.event for step in found] == [sound, lost]
    assert [step.innovation.decision for step in found] == ["accepted", "unusable"]
    after, _ = estimator.step(estimator.initial(), sound)
    np.testing.assert_array_equal(found[-1].after.mean, after.mean)


def test_rows_that_one_state_owns_are_not_overwritten_by_another():
    one = Buffer(5, 1).appended(0, np.ones((3, 1)))
    # a state that owns two of the rows goes on another way
    other = one.appended(2, np.array([[3.0]]))
    assert one.rows[:3, 0].tolist() == [1.0, 1.0, 1.0]
    assert other.rows[:3, 0].tolist() == [1.0, 1.0, 3.0]


def test_a_profile_logged_twice_counts_once():
    log = quick_log(6)
    estimator = build_estimator(ENSEMBLE, CONFIG)
    found = estimator.step_group(estimator.initial(), ProfileGroup((*log[:3], log[2], *log[3:])))
    twice = [step for step in found if step.innovation.profiles == 1]
    assert [bool((step.innovation.reasons & Reason.DUPLICATE).all()) for step in twice] == [True]
    assert found[-1].innovation.profiles == 6


@pytest.mark.parametrize("block", [1, 7, 1000])
def test_blocks_change_no_bit(block):
    estimator = replace(
        build_estimator(ENSEMBLE, CONFIG, GatingConfig()), grouping=Grouping(1e-6, 0.0, 9.0)
    )
    log = quick_log(45, dropouts=0.1)
    whole, expected = assimilate(
        estimator, EstimationState(estimator.initial(), estimator.initial()), log
    )
    state, steps = EstimationState(estimator.initial(), estimator.initial()), []
    for begin in range(0, len(log), block):
        state, more = assimilate(
            estimator, state, log[begin : begin + block], last=begin + block >= len(log)
        )
        steps += more
    assert [step.assimilation.innovation.profiles for step in steps] == [10, 10, 10, 10, 5]
    assert state.current.mean.tobytes() == whole.current.mean.tobytes()
    for one, other in zip(steps, expected, strict=True):
        assert (
            one.assimilation.innovation.innovation.tobytes()
            == other.assimilation.innovation.innovation.tobytes()
        )
        assert one.assimilation.innovation.nis == other.assimilation.innovation.nis
    assert state.waiting == ()


def test_groups_end_where_the_current_may_differ_and_hold_alike_profiles():
    first = quick_log(1)[0]
    grouping = Grouping(gradient=1e-5, change=0.0, seconds=100.0)
    far = replace(
        first, time_ns=first.time_ns + SECOND, latitude=first.latitude + 1300.0 / 111_200.0
    )
    near = replace(far, latitude=first.latitude + 1200.0 / 111_200.0)
    # a quarter of 5 cm/s over 1e-5 1/s, half of that for four profiles
    assert grouping.fits(first, near)
    assert grouping.fits(first, replace(near, time_ns=first.time_ns))
    assert not grouping.fits(first, far)
    assert not grouping.fits(first, near, 4)
    assert grouping.fits(first, replace(near, latitude=first.latitude + 600.0 / 111_200.0), 4)
    assert grouping.by_hand(100.0).fits(first, near, 4)
    for change in (
        {"time_ns": first.time_ns + 101 * SECOND},
        {"time_ns": first.time_ns - SECOND},
        {"dive": 3},
        {"depth": first.depth + 1000.0},
        {"source": replace(first.source, topic="/other")},
        {"platform_velocity": (0.0, 0.0)},
        {"common_std": np.inf},
        {"depth": first.depth[1:], "flags": first.flags[1:]},
    ):
        assert not grouping.fits(first, replace(near, **change)), change
    forgetting = Grouping(gradient=0.0, change=0.0125**2 / 50.0, seconds=100.0)
    assert forgetting.fits(first, replace(first, time_ns=first.time_ns + 49 * SECOND))
    assert not forgetting.fits(first, replace(first, time_ns=first.time_ns + 51 * SECOND))
    assert forgetting.by_hand(80.0).fits(first, replace(first, time_ns=first.time_ns + 79 * SECOND))


def test_sparse_pings_are_each_alone_to_the_bit():
    log = [replace(p, time_ns=k * 600 * SECOND) for k, p in enumerate(profiles(20))]
    found = []
    for window in ("auto", 0.0):
        estimator = with_window(build_estimator(ENSEMBLE, CONFIG, GatingConfig()), window)
        state, steps = assimilate(
            estimator, EstimationState(estimator.initial(), estimator.initial()), log
        )
        found.append(state.current.mean.tobytes())
        assert [step.assimilation.innovation.profiles for step in steps] == [1] * len(log)
    assert found[0] == found[1]


@pytest.mark.parametrize("wrong", [-1.0, "often", float("nan")])
def test_a_window_is_a_time_or_auto(wrong):
    with pytest.raises(ValueError, match="window"):
        TimeConfig(window=wrong)


def test_the_degrees_of_freedom_for_signal_are_the_trace_of_what_moves_the_values():
    estimator, one = build_estimator(ENSEMBLE, CONFIG), profiles(1)
    _, said = estimator.step(estimator.initial(), one[0])
    design, _ = rows_of(estimator, one)
    signal = design @ estimator.prior.covariance() @ design.T
    moved = np.linalg.solve(signal + np.eye(len(signal)), signal)
    assert said.signal_dof == pytest.approx(np.trace(moved), rel=1e-6)
