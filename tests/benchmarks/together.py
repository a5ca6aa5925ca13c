"""Several gliders planned together: joint surveys beside each for itself, and how truly the share of samples that come near is stated.

``python -m tests.benchmarks together`` leaves members out in turn: surveys are flown in the member as the truth, and in samples.
"""

import time
from collections.abc import Sequence
from functools import lru_cache
from itertools import islice

import numpy as np

from planners import MissionRequest, MissionSettings
from planners.learning.closed_loop import Sea, drawn_sea
from planners.learning.comparison import realised
from planners.learning.current import currents_of
from planners.learning.values import Box, LearnRequest, LearnSettings
from planners.together.missions import plan_missions, share_of_nearer
from planners.together.surveys import JointSurvey, plan_joint_survey
from replay_kit.config.run import EstimatorConfig, ForecastConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import to_geographic
from replay_kit.core.grid import Ensemble
from replay_kit.estimator import build_estimator
from replay_kit.estimator.basis.modes import embed_member
from replay_kit.forecast import read_ensemble
from replay_kit.studies.bench.plans import as_sample
from replay_kit.studies.twins.truths import leave_out
from tests import synthetic
from tests.benchmarks.array import SEAS
from tests.benchmarks.measure import Row, row
from tests.planners.flow_samples import place

_GLIDERS, _PROFILES, _DEPTH, _DRAWN = 3, 6, 280.0, 100
_TWINS, _PAIRS, _SAMPLES, _NEAR = 24, 200, 40, 3000.0
# Pairs of missions in each twin.
_OF_A_TWIN = 5
_NAMES = "this plan", "each for itself", "lawn-mowers"


def rows(tiny: bool) -> list[Row]:
    """Return what was measured."""
    if tiny:
        small = synthetic.ensemble(n_members=6, shape=(9, 11))
        return [
            _surveys("synthetic", small, (1, 12, 2, 20)),
            _pairs("synthetic", small, (1, 12, 4, 300.0)),
        ]
    seas = {
        name: read_ensemble(path, ForecastConfig()) for name, path in SEAS.items() if path.exists()
    }
    found = [_surveys(name, sea, (_TWINS, 60, _PROFILES, _DRAWN)) for name, sea in seas.items()]
    return [
        *found,
        *(
            _pairs(name, sea, (_PAIRS // len(seas), 60, _SAMPLES, _NEAR))
            for name, sea in seas.items()
        ),
    ]


@lru_cache(maxsize=1)
def _twin(sea: Ensemble, number: int, modes: int) -> tuple[FlowEstimate, FlowEstimate]:
    """Return the estimate without a member, before any measurement, and the member on its nodes."""
    case = leave_out(sea, number % sea.n_members)
    config = EstimatorConfig(modes=modes, representation_error_std=0.0)
    estimator = build_estimator(case.ensemble, config)
    flow = estimator.flow(estimator.initial())
    return flow, as_sample(flow, embed_member(case.truth, 0, config))


def _drawn(flow: FlowEstimate, rng: np.random.Generator, count: int, share: float) -> Array:
    """Return places in the middle of a region, shape (count, 2) [m]: of such a share of its sides."""
    axes = [
        (float(np.mean([axis.min(), axis.max()])), float(np.ptp(axis)))
        for axis in (flow.grid.east, flow.grid.north)
    ]
    return np.column_stack(
        [rng.uniform(m - share * w / 2, m + share * w / 2, count) for m, w in axes]
    )


def _surveys(name: str, sea: Ensemble, size: tuple[int, int, int, int]) -> Row:
    """Return the errors of joint surveys over those of each glider for itself: expected, in samples, in the truth.

    Args:
        name: Of the sea.
        sea: Its members.
        size: Number of twins, of modes, of profiles of each glider, of samples.
    """
    count, *more = size
    made = (one_survey(sea, k, *more) for k in range(10 * count))
    found = list(islice(filter(None, made), count))
    assert len(found) == count, "no scene of the sea can be surveyed"
    errors, spent = zip(*found, strict=True)
    return surveys_row(name, np.array(errors), sum(spent) / count)


def one_survey(
    sea: Ensemble, number: int, modes: int, profiles: int, drawn: int
) -> tuple[Array, float] | None:
    """Return the errors of the surveys of a twin, of ``_errors``, and a plan's processor time [s]; None where no leg may be flown."""
    rng, (flow, truth) = np.random.default_rng((0, number)), _twin(sea, number, modes)
    settings = LearnSettings(depth=_DEPTH, dives=3, samples=drawn)
    half = 0.25 * min(np.ptp(flow.grid.east), np.ptp(flow.grid.north), 160e3)
    middle = _drawn(flow, rng, 1, 0.3)[0]
    west, south = to_geographic(flow.grid.projection, *(middle - half))
    east, north = to_geographic(flow.grid.projection, *(middle + half))
    starts = middle + rng.uniform(-half, half, (_GLIDERS, 2))
    asked = [
        LearnRequest(place(flow, *one, 0.0), (), settings=settings, profiles=profiles)
        for one in starts
    ]
    box = Box(float(west), float(south), float(east), float(north))
    begin = time.process_time()
    try:
        joint = plan_joint_survey(flow, asked, box)
    except PlanError:
        # on land, or beside the edge of the region
        return None
    return _errors(joint, truth), time.process_time() - begin


def surveys_row(name: str, errors: Array, spent: float) -> Row:
    """Return the row of some twins' errors, shape (twins, 3, names), and a plan's processor time [s]."""
    count = len(errors)
    ratios = {
        f"{kind} over {peer}": table[:, 0] / table[:, k]
        for kind, table in zip(
            ("expected", "samples", "truth"), errors.transpose(1, 0, 2), strict=True
        )
        for k, peer in enumerate(_NAMES[1:], 1)
    }
    error = {text: float(np.exp(np.mean(np.log(values)))) for text, values in ratios.items()}
    spread = {
        f"{text} +-": 1.645 * float(np.std(np.log(values), ddof=min(1, count - 1)) / np.sqrt(count))
        for text, values in ratios.items()
    }
    return row(
        f"{name}: {_GLIDERS} gliders together, {count} twins: .9 of each for itself",
        spent,
        "each for itself",
        error={**error, **spread},
    )


def _errors(joint: JointSurvey, truth: FlowEstimate) -> Array:
    """Return the errors [m/s] expected, in samples and in the truth, shape (3, names)."""
    by_name = {one.name: one for one in joint.candidates}
    mapping, _ = joint.flown["this plan"][0]
    known = mapping.known
    drawn = drawn_sea(known, np.zeros(1), 2, 0)
    own = currents_of(known.flow, [(truth.latent @ known.weights[0])[None]], np.zeros(1))
    sea = Sea(known, drawn.times, drawn.mean, own)
    count = sum(survey.times.size for _, survey in joint.flown["this plan"])
    noise = np.random.default_rng(0).standard_normal((1, count, 2))
    return np.array(
        [
            [by_name[name].predicted if name in by_name else np.nan for name in _NAMES],
            [by_name[name].found if name in by_name else np.nan for name in _NAMES],
            [float(realised(sea, joint.flown[name], noise)[0]) for name in _NAMES],
        ]
    )


def _pairs(name: str, sea: Ensemble, size: tuple[int, int, int, float]) -> Row:
    """Return the share of samples in which two missions come near, as stated and in fresh samples.

    Args:
        name: Of the sea.
        sea: Its members.
        size: Number of pairs, of modes, of samples, and the separation [m].
    """
    count, *more = size
    made = (one_pair(sea, k, *more) for k in range(10 * count))
    found = list(islice(filter(None, made), count))
    assert len(found) == count, "no pair of missions of the sea can be planned"
    return pairs_row(name, found, more[-1])


def one_pair(
    sea: Ensemble, number: int, modes: int, drawn: int, near: float
) -> tuple[float, float, float, bool, float] | None:
    """Return the shares of samples, searched, stated and fresh, in which two missions come near, whether one goes round, and the time [s].

    None where one of them cannot be planned. Some pairs in turn are of one twin.
    """
    rng, (flow, _) = np.random.default_rng((1, number)), _twin(sea, number // _OF_A_TWIN, modes)
    middle, turn = _drawn(flow, rng, 1, 0.3)[0], rng.uniform(0.0, 2.0 * np.pi, 2)
    half = 8e3 * np.column_stack([np.cos(turn), np.sin(turn)])
    settings = MissionSettings(depth=_DEPTH, tolerance=500.0)
    asked = [
        MissionRequest(
            place(flow, *(middle - way), 0.0),
            (place(flow, *(middle + way), 0.0),),
            settings=settings,
        )
        for way in half
    ]
    samples = [flow.sample(drawn, 3 * number + k) for k in range(3)]
    begin = time.process_time()
    try:
        joint = plan_missions(flow, samples[0], asked, near)
    except PlanError:
        return None
    spent = time.process_time() - begin
    stated, fresh = (share_of_nearer(flow, one, joint, (0, 1), near) for one in samples[1:])
    moved = any(len(one.no_go) for one in joint.requests)
    return joint.nearness[0].share, stated, fresh, moved, spent


def pairs_row(
    name: str, found: Sequence[tuple[float, float, float, bool, float]], near: float
) -> Row:
    """Return the row of some pairs kept so far apart [m]."""
    searched, stated, fresh, moved, spent = np.array(found).T
    off = stated - fresh
    return row(
        f"{name}: {len(found)} pairs of missions kept {near / 1e3:g} km apart",
        float(spent.mean()),
        "fresh samples",
        error={
            "searched": float(searched.mean()),
            "stated": float(stated.mean()),
            "fresh": float(fresh.mean()),
            "off": float(off.mean()),
            "off +-": 1.645 * float(off.std() / np.sqrt(len(found))),
            "gone_round": float(moved.mean()),
        },
    )
