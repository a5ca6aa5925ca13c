"""Plans that learn: how quickly and how truly candidates are judged, beside whole runs of the estimator, and how long plans take."""

import time
from dataclasses import replace
from typing import Any

import numpy as np

from planners import Glider
from planners.front.current import shares_of_levels
from planners.learning.choose import Aim
from planners.learning.closed_loop import mean_currents
from planners.learning.loops import shapes, timed
from planners.learning.maps import plan_map
from planners.learning.rows import rows_at
from planners.learning.survey import plan_survey
from planners.learning.transit import end_sensitivity, plan_transit
from planners.learning.values import Box, LearnRequest, LearnSettings
from replay_kit.config.run import EstimatorConfig, ForecastConfig
from replay_kit.core.arrays import Array
from replay_kit.core.flow.depth_means import depth_means
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.grid import Ensemble
from replay_kit.estimator import build_estimator
from replay_kit.forecast import read_ensemble
from tests import synthetic
from tests.benchmarks.measure import Row, cpu, row
from tests.places import DATA
from tests.planners.flow_samples import place

NEMO = DATA / "natl_nemo" / "ensemble.nc"
_HOUR, _DEPTH, _NOISE = 3600.0, 280.0, 0.09
# Survey and stretch [h], and where it ends [m].
_SURVEY, _BLIND, _GOAL = 28.0, 23.0, 20e3 + 5e3j


def rows(tiny: bool) -> list[Row]:
    """Return what was measured."""
    ensemble = (
        synthetic.ensemble(n_members=8, shape=(12, 14))
        if tiny or not NEMO.exists()
        else read_ensemble(NEMO, ForecastConfig())
    )
    # without an error of what the basis does not represent, so that both updates count the same errors
    estimator = build_estimator(
        ensemble, EstimatorConfig(modes=12 if tiny else 300, representation_error_std=0.0)
    )
    flow = estimator.flow(estimator.initial())
    known = depth_means(flow, shares_of_levels(flow, _DEPTH, 0.0)[None])
    mean, speed = (
        mean_currents(known, np.zeros(1)),
        float(Glider().speeds(np, Glider().angles[0])[0]),
    )
    planned = plan_transit(
        mean, np.zeros(1, dtype=complex), _SURVEY * _HOUR, np.array([_GOAL]), _BLIND * _HOUR, speed
    )
    sense = end_sensitivity(mean, 0j, _SURVEY * _HOUR, planned)
    points = np.stack([sense.points.real, sense.points.imag], axis=-1)
    depth = np.arange(16.0, _DEPTH + 1.0, 16.0)

    def error_of(flow: FlowEstimate) -> float:
        means = depth_means(flow, known.weights)
        return Aim(means, rows_at(means, points, sense.times).combined(sense.weights), 1.0).before()

    aim = Aim(
        known, rows_at(known, points, sense.times).combined(sense.weights), _NOISE**2 / depth.size
    )
    cheap, (survey, errors) = cpu(
        lambda: (
            (made := timed(mean, 0j, shapes(_GOAL), (0.0, _SURVEY * _HOUR, 10), speed)),
            aim.judge(made),
        ),
        1 if tiny else 5,
    )
    tried = (0, 1) if tiny else (0, 1, 9, 20, 33, 50)
    began, off = time.process_time(), []
    for k in tried:
        state = estimator.initial()
        for after, _ in estimator.steps(state, _profiles(ensemble, flow, survey.points[k], depth)):
            state = after
        off.append(abs(float(errors[k]) / error_of(estimator.flow(state)) - 1.0))
    whole = (time.process_time() - began) / len(tried) * 65
    of_a_run, name = (
        {"of_a_run": max(off)},
        "65 surveys judged: within 3 % of runs of the estimator asked",
    )
    made = [
        row(
            name,
            cheap,
            "as many runs of the estimator",
            error=of_a_run,
            asked_s=0.1,
            peer_runs_s=whole,
        )
    ]
    return made + _plans(flow, tiny)


def _profiles(ensemble: Ensemble, flow: FlowEstimate, places: Array, depth: Array) -> list[Any]:
    rng, found = np.random.default_rng(0), []
    for k, at in enumerate(places):
        values = flow.velocity(*at, depth) + _NOISE * rng.standard_normal((depth.size, 2))
        found.append(synthetic.profile(ensemble.grid, *at, depth, values, _NOISE, time_ns=k))
    return found


def _plans(flow: FlowEstimate, tiny: bool) -> list[Row]:
    """Return the processor time of one plan of each kind."""
    samples = 20 if tiny else 200
    settings = LearnSettings(depth=_DEPTH, samples=samples)
    start = place(flow, 0.0, 0.0, 0.0)
    asked = LearnRequest(start, (place(flow, _GOAL.real, _GOAL.imag, 0.0),), settings=settings)
    box = [place(flow, sign * 25e3, sign * 20e3, 0.0) for sign in (-1, 1)]
    mapped = replace(
        asked, goals=(), profiles=4 if tiny else 20, settings=replace(settings, dives=3)
    )
    kinds = {
        "a survey before a stretch": lambda: plan_survey(
            flow, asked, _SURVEY * _HOUR, _BLIND * _HOUR
        ),
        "a map": lambda: plan_map(
            flow, mapped, Box(box[0].longitude, box[0].latitude, box[1].longitude, box[1].latitude)
        ),
    }
    return [row(f"plan of {name}", cpu(work)[0], asked_s=20.0) for name, work in kinds.items()]
