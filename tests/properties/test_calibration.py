"""Stated probabilities and bounds against draws and closed forms: a factor of two on any variance, a quantile or a margin shows."""

import functools

import numpy as np
import pytest

import planners
import replay_kit as rk
from replay_kit.config.estimation import GatingConfig, TimeConfig
from replay_kit.config.run import EstimatorConfig
from replay_kit.estimator import build
from tests.properties.world import GLIDER, HERE, mission, places, replace, replayed, sea, tables

DEPTHS = np.linspace(8.0, 280.0, 30)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    file = tmp_path_factory.mktemp("forecast") / "e.nc"
    tables(sea())[1].to_netcdf(file)
    forecast = rk.open_ensemble(file)

    @functools.cache
    def built(unresolved=0.0, **gating):
        stated = {
            "sample_share": 0.5,
            "shift_distance": 1e4,
            "dropped_std": 0.0,
            "spread": 1.0,
            "mean_variance": 0.0,
        }
        config = EstimatorConfig(**stated, representation_error_std=unresolved)
        return build([forecast], config, GatingConfig(**gating), TimeConfig())

    return built


def truths(estimator, count, seed):
    return estimator.flow(estimator.initial()).sample(count, seed)


def profile(truth, rng, noise=0.05, stated=0.05, number=0):
    """A profile of a truth at a random place."""
    lon, lat, _ = places(rng.uniform(-3e4, 3e4, 2), HERE)
    v = truth.velocity_at(lon, lat, DEPTHS)
    u, v = np.stack([v.u, v.v]) + noise * rng.standard_normal((2, DEPTHS.size))
    return rk.Observation.profile(number, float(lon), float(lat), DEPTHS, u, v, stated)


def squares_of_errors(flow, truth, rng):
    """Mean squares of errors over standard errors at random places, east and north."""
    lon, lat, _ = places(rng.uniform(-3e4, 3e4, (6, 2)), HERE)
    got, true = (each.velocity_at(lon, lat, 100.0) for each in (flow, truth))
    return [
        np.mean(((got.u - true.u) / got.u_standard_error) ** 2),
        np.mean(((got.v - true.v) / got.v_standard_error) ** 2),
    ]


def test_the_gate_stops_as_many_as_it_says(made):
    p, it, rng = 0.06, made(gate_probability=0.06), np.random.default_rng(5)
    drawn = [profile(truth, rng) for truth in truths(it, 100, 5) for _ in range(3)]
    steps = [it.assimilate(it.initial(), [each])[1][0] for each in drawn]
    stopped = np.mean([step.innovation.decision == "rejected" for step in steps])
    assert abs(stopped - p) < 3 * np.sqrt(p / 300)


def test_scatter_beyond_the_stated_error_counts_as_if_it_had_been_stated(made):
    it, ratios = made(gate_probability=1e-5), []
    for number, truth in enumerate(truths(it, 28, 6)):
        information = []
        for stated in (0.15, 0.05):
            seen = profile(truth, np.random.default_rng(number), 0.15, stated)
            state, _ = it.assimilate(it.initial(), [seen])
            at = seen.longitude, seen.latitude, 150.0
            before, after = (
                it.flow(each).velocity_at(*at).u_standard_error for each in (it.initial(), state)
            )
            information.append(float(after**-2 - before**-2))
        ratios.append(information[1] / information[0])
    assert 0.8 < np.median(ratios) < 1.25


def test_errors_are_as_large_as_stated_where_nothing_was_measured(made):
    """Truths drawn from the prior, four profiles of each: the mean square of errors over standard errors is one, through the water."""
    it, rng, squares = made(gate_probability=1e-5), np.random.default_rng(7), []
    for truth in truths(it, 60, 8):
        state = it.initial()
        for number in range(4):
            state, _ = it.assimilate(state, [profile(truth, rng, number=number)])
        squares += squares_of_errors(it.flow(state), truth, rng)
    assert 0.75 < np.mean(squares) < 1.3


@pytest.mark.parametrize("turn", [0.06, 0.24])
def test_errors_are_about_as_large_as_stated_in_a_current_that_changes(made, turn):
    """A profile each half day for six, in truths that turn into others, in radians a day; held constant, 2 to 7 times as large."""
    it, rng, squares = made(gate_probability=1e-5), np.random.default_rng(9), []
    mean = it.flow(it.initial()).latent
    for one, other in zip(truths(it, 8, 9), truths(it, 8, 10), strict=True):
        state = it.initial()
        for number in range(13):
            angle = 0.5 * turn * number
            off = np.cos(angle) * (one.latent - mean) + np.sin(angle) * (other.latent - mean)
            truth = replace(one, latent=mean + off)
            seen = profile(truth, rng, number=number * 43_200 * 10**9)
            state, _ = it.assimilate(state, [seen])
        squares += squares_of_errors(it.flow(state), truth, rng)
    assert 0.3 < np.mean(squares) < 1.6


def test_errors_that_persist_from_bin_to_bin_though_stated_as_independent_reject_no_profile(made):
    it, depths, taken = made(gate_probability=1e-5), np.arange(8.0, 280.0, 2.0), []
    alike = np.linalg.cholesky(np.exp(-np.abs(depths[:, None] - depths) / 30.0))
    for number, truth in enumerate(truths(it, 16, 11)):
        rng, state = np.random.default_rng(number), it.initial()
        for k in range(6):
            lon, lat, _ = places(rng.uniform(-3e4, 3e4, 2), HERE)
            v = truth.velocity_at(lon, lat, depths)
            u, v = np.stack([v.u, v.v]) + 0.05 * (alike @ rng.standard_normal((depths.size, 2))).T
            seen = rk.Observation.profile(k, float(lon), float(lat), depths, u, v, 0.05)
            state, (step,) = it.assimilate(state, [seen])
            taken.append(step.innovation.accepted)
    assert np.mean(taken) > 0.95


def test_errors_hold_where_many_profiles_share_a_current_that_the_forecast_cannot_resolve(made):
    """A vessel's pings at 1 Hz, all in one cell: their gradient is as much that of an eddy smaller than a cell."""
    it, rng, squares = made(gate_probability=1e-5, unresolved=0.03), np.random.default_rng(9), []
    for truth in truths(it, 12, 9):
        lon, lat, _ = places(rng.uniform(-2e4, 2e4, 2) + 2.0 * np.arange(300)[:, None], HERE)
        v = truth.velocity_at(lon[:, None], lat[:, None], DEPTHS)
        eddy = 0.03 * np.sqrt(2) * np.sin(np.arange(300) / 450 + rng.uniform(0, 6, (2, 1)))
        measured = np.stack([v.u, v.v]) + eddy[..., None]
        measured += 0.1 * rng.standard_normal(measured.shape)
        pings = [
            rk.Observation.profile(k, float(x), float(y), DEPTHS, *measured[:, k], 0.1)
            for k, (x, y) in enumerate(zip(lon, lat, strict=True))
        ]
        state, _ = it.assimilate(it.initial(), pings)
        squares += squares_of_errors(it.flow(state), truth, rng)
    assert 0.6 < np.mean(squares) < 1.4


def test_a_pilot_who_is_right_arrives_as_planned_where_meridians_converge():
    there = (20.0, 82.0)
    flow = replayed(sea(), there)
    plan = mission(flow, centre=there)
    request = planners.MissionRequest(plan.start, plan.goals, GLIDER, plan.settings)
    flown = planners.mission_odds(flow, [flow] * 3, plan, request)
    assert flown.miss_median < plan.closest_approach[-1] + 50.0


@pytest.mark.parametrize("current", [0.0, 0.12])
def test_no_bound_is_later_than_zermelo_in_any_direction(current):
    """In a uniform current the quickest way is straight, and its time a formula."""
    s, rng = sea(2, rough=0.0), np.random.default_rng(4)
    uniform = [current, 0.0] + 0.05 * rng.standard_normal((len(s.members), 1, 1, 1, 2))
    profiles = s.profiles.copy()
    profiles[..., 4:] = [current, 0.0] + 0.02 * rng.standard_normal(profiles[..., 4:].shape)
    flow = replayed(
        replace(s, members=np.broadcast_to(uniform, s.members.shape), profiles=profiles)
    )
    x, y, z = np.meshgrid([-2e4, 0.0, 2e4], [-2e4, 0.0, 2e4], [5.0, 125.0, 250.0])
    lon, lat, _ = places(np.stack([x, y], -1), HERE)
    v = flow.velocity_at(lon, lat, z)
    u, w, loose = np.mean(v.u), np.mean(v.v), max(np.ptp(v.u), np.ptp(v.v))
    ratios = []
    for a in np.deg2rad(np.arange(7.0, 367.0, 30.0)):
        way = np.array([np.cos(a), np.sin(a)])
        plan = mission(flow, (0.0, 0.0), 2.6e4 * way)
        if "bound_h" in plan.statistics:
            speed = GLIDER.speed * np.cos(np.deg2rad(np.abs(plan.glide_angles_deg).min()))
            along, across = way @ [u, w], way @ [w, -u]
            quickest = (2.6e4 - 300.0) / (along + np.sqrt(speed**2 - across**2))
            ratios.append(3600.0 * plan.statistics["bound_h"] / quickest)
    assert len(ratios) > 6
    assert max(ratios) < 1.0 + loose / 0.3
