"""What the studies of planning share: truths withheld in turn, estimates that do not know them, goals that can be reached, the glider."""

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np

import planners
from replay_kit.config.run import EstimatorConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import ConfigError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.grid import Ensemble
from replay_kit.core.observation import Observation
from replay_kit.core.plan import Plan
from replay_kit.estimator import embed_member
from replay_kit.estimator.baselines import average_over_depth
from replay_kit.studies.accuracy.methods import build_method
from replay_kit.studies.jobs import Advance, each_counted
from replay_kit.studies.planning.job import PlanningJob
from replay_kit.studies.reports.flows import AVERAGED, TRUTH
from replay_kit.studies.twins.adcp import random_observations
from replay_kit.studies.twins.field import Field, build_field
from replay_kit.studies.twins.reachable import SPEED, Pair, draw_reachable, fly_dives
from replay_kit.studies.twins.truths import Case, leave_out
from replay_kit.studies.twins.vehicle import random_places
from replay_kit.workflows.replay.scoring import ScoredPoints, rms_length, scored_points

METHODS = ("default", "naive3d", "ensemble_mean", "nearest")
#: Everything that plans are made on.
FLOWS = (TRUTH, AVERAGED, *METHODS)
# Least and greatest glide angle of a mission [degrees].
ANGLES = (15.0, 35.0)
_Made = TypeVar("_Made")
_Planned = TypeVar("_Planned", bound=Plan | planners.MissionPlan)
# The naive basis has the paper's errors of a bin, under which it was published.
_PRESETS = {"naive3d": "paper"}


@dataclass(frozen=True, eq=False)
class Withheld:
    """A truth, and what an estimator can know of it.

    Attributes:
        case: The truth and the members that do not know it.
        config: Of the estimators.
        job: The options; their number of pings.
    """

    case: Case
    config: EstimatorConfig
    job: PlanningJob

    @property
    def member(self) -> int:
        """Position of the member left out; for a truth of its own the number of members."""
        return self.case.ensemble.n_members if self.case.member is None else self.case.member

    @cached_property
    def truth(self) -> FlowEstimate:
        """The truth as the planner sees it."""
        return embed_member(self.case.truth, 0, self.config)

    @cached_property
    def field(self) -> Field:
        """The truth as instruments see it."""
        return build_field(self.case.truth)

    @cached_property
    def observations(self) -> tuple[Observation, ...]:
        """Profiles at random places of the truth."""
        return random_observations(self.field, self.job.pings, self.job.noise, self.job.seed)

    def estimate(self, method: str = "default") -> FlowEstimate:
        """Return a method's estimate after all profiles, with its uncertainty."""
        config = self.config.model_copy(update={"preset": _PRESETS.get(method, "default")})
        estimator = build_method(method, self.case.ensemble, config)
        state = estimator.initial()
        for after, _ in estimator.steps(state, self.observations):
            state = after
        return estimator.flow(state)

    @cached_property
    def estimated(self) -> Mapping[str, FlowEstimate]:
        """Each method's estimate, without its uncertainty."""
        return {method: self.estimate(method).mean_flow() for method in METHODS}

    def flows(self, depth: float) -> dict[str, FlowEstimate]:
        """Return everything to plan on, for what goes down to a depth [m]."""
        return {
            TRUTH: self.truth,
            AVERAGED: average_over_depth(self.truth, depth),
            **self.estimated,
        }

    @cached_property
    def at(self) -> ScoredPoints:
        """Where estimates are compared with the truth."""
        return scored_points(self.case.ensemble.grid, self.case.truth)

    def relative_error(self, flow: FlowEstimate, depth: float) -> float:
        """Return a flow's RMS error over the truth's RMS speed, at the grid points down to a depth [m]."""
        kept = self.at.depth <= depth
        east, north, down = (values[kept] for values in self.at.place)
        return rms_length(flow.velocity(east, north, down) - self.at.velocity[kept]) / rms_length(
            self.at.velocity[kept]
        )


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """What a study is given.

    Attributes:
        ensemble: All members.
        truths: One for each member left out, or one of its own.
        job: The options.
        advance: Counts steps of what is being run.
    """

    ensemble: Ensemble
    truths: tuple[Withheld, ...]
    job: PlanningJob
    advance: Advance

    def shares(self, count: int) -> tuple[int, ...]:
        """Return the number of cases of each truth when a count is spread over the truths as evenly as possible."""
        return tuple(len(part) for part in np.array_split(np.arange(count), len(self.truths)))

    def each_truth(
        self, function: Callable[["World", int], _Made], count: int, steps: int = 1
    ) -> Iterator[_Made]:
        """Yield what a function makes of each truth that has a share of cases.

        Args:
            function: Takes a world of one truth, and its share.
            count: Of the cases of all truths.
            steps: Of a case.
        """
        calls = (
            (replace(self, truths=(truth,)), share)
            for truth, share in zip(self.truths, self.shares(count), strict=True)
            if share
        )
        for _, made in each_counted(function, calls, self.advance, lambda _, share: steps * share):
            yield made

    @property
    def depth(self) -> float:
        """Of a mission's dives [m]: the job's, or the deepest level."""
        return min(self.job.depth, float(self.truths[0].case.ensemble.grid.levels[-1]))

    @property
    def glider(self) -> planners.Glider:
        """The vehicle of missions."""
        return planners.Glider(SPEED, None, *ANGLES)


def timed(make: Callable[[], _Made]) -> tuple[_Made, float]:
    """Return what a function returns, and the seconds it took."""
    began = time.perf_counter()
    return make(), time.perf_counter() - began


def build_world(
    ensemble: Ensemble,
    truth: Ensemble | None,
    config: EstimatorConfig,
    job: PlanningJob,
    advance: Advance,
) -> World:
    """Return the world of an ensemble; estimates are made when they are first asked for.

    Args:
        ensemble: All members.
        truth: An ensemble of one; None to leave members out.
        config: Of the estimators.
        job: The options.
        advance: Counts steps of what is being run.

    Raises:
        ConfigError: A member does not exist, too few are left, or members are to be left out beside a truth.
    """
    if truth is not None and job.leave_out is not None:
        raise ConfigError("planning: expected one of --truth and --leave-out")
    members = job.members(ensemble.n_members)
    cases = (
        [leave_out(ensemble, member) for member in members]
        if truth is None
        else [Case(None, truth, ensemble)]
    )
    return World(ensemble, tuple(Withheld(case, config, job) for case in cases), job, advance)


Polygon = tuple[tuple[float, float], ...]
# Distance between the points of a path that are checked [m].
_SPACING = 10.0
# Glide angles that goals are drawn with [degrees]: some of a mission's range is left to the planner.
_DRAWN_ANGLES = (16.0, 25.0)
# Standard deviation of a mission's headings about a common one [rad].
_SCATTER = 0.3


def draw_missions(
    withheld: Withheld, flow: FlowEstimate, count: int, depth: float, legs: int, seed: int
) -> tuple[Pair, ...]:
    """Return starts and goals at the surface, each goal the end of a mission of random headings flown in a current.

    The mission keeps to water that is as deep as its dives, in the grids of the current and of the forecast.

    Args:
        withheld: The truth, for places at its wet surface.
        flow: The current that the missions are flown in.
        count: Number of missions.
        depth: Of the dives [m].
        legs: Of each mission.
        seed: Of starts, headings and glide angles.

    Raises:
        ForecastError: Hardly any mission stays in the water.
    """
    # a stream of its own: neither the pings' places nor the glides'
    rng = np.random.default_rng((seed, 2, withheld.member))

    def fly() -> Array:
        start = random_places(withheld.field, count, rng)
        headings = rng.uniform(0.0, 2.0 * np.pi, (count, 1)) + _SCATTER * rng.standard_normal(
            (count, legs)
        )
        return fly_dives(
            flow, start, headings, np.deg2rad(rng.uniform(*_DRAWN_ANGLES, (count, legs))), depth
        )

    grids = flow.grid, withheld.case.ensemble.grid
    return draw_reachable(
        fly, grids, count, f"missions of {legs} dives to {depth:g} m", 0.0, water_depth=depth
    )
