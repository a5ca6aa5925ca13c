"""Twins of a survey before a stretch without fixes: a member left out is the truth, the estimator's own update learns from whole profiles.

Each twin waits, scouts ahead and back, flies random loops and the planned survey, all as long, and then the same stretch by dead reckoning.
The goal is where a vehicle of nearly its speed would end in the truth, so that each is within reach.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planners import Glider
from planners.front.current import shares_of_levels
from planners.learning.choose import Aim, allowed_errors, search
from planners.learning.closed_loop import Sea, Stretch, fly_survey, mean_currents, slices
from planners.learning.current import Complex, Currents, currents_of
from planners.learning.loops import SCOUTING, WAITING, Survey, clear, random_shapes, shapes, timed
from planners.learning.rows import rows_at
from planners.learning.transit import Transit, end_sensitivity, fly, fly_transit, plan_transit
from planners.route.hazards import Ring
from replay_kit.config.run import RunConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import ForecastError
from replay_kit.core.flow.depth_means import DepthMeans, depth_means
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import inside_grid, rotate_to_geographic, to_geographic
from replay_kit.core.grid import Ensemble, Grid
from replay_kit.core.observation import Flag, Observation, Reason, Source
from replay_kit.estimator import Estimator
from replay_kit.studies.missions.scene import own_estimator, withhold
from replay_kit.studies.planning.voyages import sea_of
from replay_kit.studies.twins.field import Field, build_field
from replay_kit.studies.twins.reachable import SPEED

#: Durations of the survey and of the stretch after it [s].
SURVEY, BLIND = 28 * 3600.0, 23 * 3600.0
#: Depth of the dives [m], and the error of a profile's mean current that a survey is planned with [m/s].
DEPTH, ERROR = 400.0, 0.03
#: Share of a forecast's time after which twins begin, when its members have parted.
BEGINS = 0.3
# Members that are the same field, displaced: correlation, and cells searched.
_SAME, _CELLS = 0.98, 8
# Way kept from the edge of the region [m], random loops of a twin, and draws of a start.
_EDGE, _RANDOM, _DRAWS = 40e3, 3, 200
# Share of the speed that leads to the goal in the truth.
_SHARE = 0.9
# Bins of a profile [m], from the first on; a 90 % ellipse's squared radius.
_BIN, _ELLIPSE = 16.0, 4.605


@dataclass(frozen=True, slots=True)
class Way:
    """How one stretch ended.

    Attributes:
        miss: Distance from the goal [m].
        predicted: Its root mean square before the survey was flown [m].
        inside: Whether it ended within the ellipse that should hold 90 % of the ends.
    """

    miss: float
    predicted: float
    inside: bool


@dataclass(frozen=True, slots=True)
class SurveyTwin:
    """One truth and stretch.

    Attributes:
        member: The truth, position from 0.
        ways: By name, each flown once or, random loops, several times.
    """

    member: int
    ways: dict[str, tuple[Way, ...]]


def copies_of(ensemble: Ensemble, member: int) -> tuple[int, ...]:
    """Return the positions of the members that show the same field as one of them at most some cells displaced, it among them."""
    fields = np.nan_to_num(np.asarray(ensemble.velocity[:, :, 0]))
    count, rows, columns = len(fields), *fields.shape[2:]
    best = np.zeros(count)
    for j in range(-min(_CELLS, rows // 2), min(_CELLS, rows // 2) + 1):
        for i in range(-min(_CELLS, columns // 2), min(_CELLS, columns // 2) + 1):
            own = fields[
                member, :, max(j, 0) : rows + min(j, 0), max(i, 0) : columns + min(i, 0)
            ].ravel()
            others = fields[
                :, :, max(-j, 0) : rows + min(-j, 0), max(-i, 0) : columns + min(-i, 0)
            ].reshape(count, -1)
            norm = np.linalg.norm(own) * np.linalg.norm(others, axis=1)
            best = np.maximum(
                best, np.divide(others @ own, norm, out=np.zeros(count), where=norm > 0.0)
            )
    best[member] = 1.0
    return tuple(int(k) for k in np.flatnonzero(best > _SAME))


def without(series: Sequence[Ensemble], member: int) -> tuple[tuple[Ensemble, ...], int]:
    """Return a forecast without the copies of a member, and the member's position in it."""
    dropped = [k for k in copies_of(series[0], member) if k != member]
    kept = [
        replace(one, velocity=np.delete(one.velocity, dropped, axis=0), members=())
        for one in series
    ]
    return tuple(kept), member - sum(k < member for k in dropped)


@dataclass(frozen=True, slots=True, eq=False)
class _Twin:
    """What surveys are flown and judged with."""

    estimator: Estimator[Any]
    sea: Sea
    field: Field
    stretch: Stretch
    begin_ns: int
    rng: np.random.Generator

    def fly(self, survey: Survey | None) -> Way:
        """Return how the stretch ends after a survey; at once without one."""
        state, place, leaves = (
            self.estimator.initial(),
            np.array([self.stretch.start]),
            self.stretch.begin,
        )
        if survey is not None:
            places, _, place = fly_survey(self.sea, self.stretch, survey)
            given = profiles_of(self.field, places[0], survey.times, self.begin_ns, self.rng)
            for after, _ in self.estimator.steps(state, given):
                state = after
            leaves = self.stretch.leaves
        known = _means(
            self.estimator.flow(self.estimator.predict(state, self.begin_ns + round(leaves * 1e9)))
        )
        # its own time is when the stretch begins
        times = slices(known, 0.0, self.stretch.blind)
        currents = mean_currents(known, times)
        planned = plan_transit(
            currents, place, 0.0, self.stretch.goals, self.stretch.blind, self.stretch.speed
        )
        end = fly_transit(self.sea.truth, place, leaves, planned)
        cov = _cov_of_end(known, currents, complex(place[0]), planned)
        off = end[0] - planned.ends[0, -1]
        vector = np.array([off.real, off.imag])
        within = bool(vector @ np.linalg.solve(cov, vector) <= _ELLIPSE)
        return Way(
            float(abs(end[0] - self.stretch.goals[-1])), float(np.sqrt(np.trace(cov))), within
        )


def _means(flow: FlowEstimate) -> DepthMeans:
    return depth_means(flow, shares_of_levels(flow, DEPTH, 0.0)[None])


def _cov_of_end(known: DepthMeans, currents: Currents, start: complex, planned: Transit) -> Array:
    """Return the covariance of where a stretch ends that begins at the estimate's time, shape (2, 2) [m^2]."""
    sense = end_sensitivity(currents, start, 0.0, planned)
    rows = rows_at(known, np.stack([sense.points.real, sense.points.imag], axis=-1), sense.times)
    return rows.combined(sense.weights).variance()


def profiles_of(
    field: Field,
    places: Complex,
    times: Array,
    begin_ns: int,
    rng: np.random.Generator,
    noise: float = 0.09,
) -> list[Observation]:
    """Return whole profiles down to the dives' depth at places, shape (n,) [m], and times [s] since a beginning."""
    depth = np.arange(_BIN, DEPTH + 1.0, _BIN)
    found = []
    for k, (place, time) in enumerate(zip(places, times, strict=True)):
        time_ns = begin_ns + round(float(time) * 1e9)
        velocity = field.velocity(
            np.full(depth.size, place.real), np.full(depth.size, place.imag), depth, time_ns
        )
        longitude, latitude = to_geographic(field.grid.projection, place.real, place.imag)
        true = np.stack(
            rotate_to_geographic(field.grid.projection, longitude, latitude, *velocity.T), axis=-1
        )
        found.append(
            Observation(
                time_ns=time_ns,
                longitude=float(longitude),
                latitude=float(latitude),
                depth=depth,
                velocity=true + noise * rng.standard_normal(true.shape),
                error_std=np.full(depth.size, noise),
                reference="earth",
                flags=np.where(np.isfinite(true).all(axis=1), Flag.GOOD, Flag.MISSING).astype(
                    np.int8
                ),
                reasons=np.where(np.isfinite(true).all(axis=1), Reason.NONE, Reason.MISSING).astype(
                    np.int32
                ),
                dive=k,
                source=Source(0, "/adcp", k, time_ns),
            )
        )
    return found


def survey_twins(
    series: Sequence[Ensemble], config: RunConfig, member: int, seeds: Sequence[int]
) -> tuple[SurveyTwin, ...]:
    """Return twins of one truth, each flown in all ways.

    Raises:
        ForecastError: No stretch that stays in the truth's water was found.
    """
    kept, position = without(series, member)
    case = withhold(kept, position)
    begin_ns = int(case.times_ns[0] + BEGINS * (case.times_ns[-1] - case.times_ns[0]))
    estimator, truths = own_estimator(case, config), sea_of(case.truths, config.estimator)
    known = _means(estimator.flow(estimator.predict(estimator.initial(), begin_ns)))
    known = replace(known, time_ns=begin_ns)
    grid, speed = truths[0].grid, float(Glider(SPEED).speeds(np, Glider().angles[0])[0])
    weights, times = shares_of_levels(truths[0], DEPTH, 0.0), slices(known, 0.0, SURVEY + BLIND)
    of_truth = (
        np.array([(flow.time_ns or 0) - begin_ns for flow in truths]) / 1e9
        if len(truths) > 1
        else np.zeros(1)
    )
    truth = currents_of(truths[0], [(flow.latent @ weights)[None] for flow in truths], of_truth)
    field, sea = build_field(*case.truths), Sea(known, times, mean_currents(known, times), truth)
    twins = []
    for seed in seeds:
        rng = np.random.default_rng((seed, member))
        start, goal = _drawn(grid, truth, speed, rng)
        stretch = Stretch(start, np.array([goal]), 0.0, SURVEY, BLIND, speed, ERROR)
        twins.append(
            SurveyTwin(member, _ways(_Twin(estimator, sea, field, stretch, begin_ns, rng)))
        )
    return tuple(twins)


def _ways(twin: _Twin) -> dict[str, tuple[Way, ...]]:
    """Return the stretch after each kind of survey."""
    known, stretch, sea = twin.sea.known, twin.stretch, twin.sea
    planned = plan_transit(
        sea.mean,
        np.array([stretch.start]),
        stretch.leaves,
        stretch.goals,
        stretch.blind,
        stretch.speed,
    )
    sense = end_sensitivity(sea.mean, stretch.start, stretch.leaves, planned)
    rows = rows_at(known, np.stack([sense.points.real, sense.points.imag], axis=-1), sense.times)
    aim = Aim(known, rows.combined(sense.weights), stretch.error**2)
    dive = 2.0 * DEPTH / float(Glider(SPEED).speeds(np, Glider().angles[0])[1])
    span = (stretch.begin, stretch.survey, max(int(stretch.survey / dive), 1))

    def make(shape: Complex) -> Survey:
        return timed(sea.mean, stretch.start, shape, span, stretch.speed)

    offered, lane = make(shapes(complex(stretch.goals[0] - stretch.start))), _lane(stretch)

    def best(rings: tuple[Ring, ...]) -> Survey:
        def checked(shape: Complex) -> tuple[Survey, NDArray[np.bool_]]:
            made = make(shape)
            return made, made.flown & _within(known.flow.grid, made) & clear(
                made, stretch.start, rings, 500.0
            )

        loops = offered.corners - stretch.start
        return make(search(aim, checked, loops, allowed_errors(aim, *checked(loops)))[0][None])

    loops = make(random_shapes(twin.rng, 20 * _RANDOM))
    usable = np.flatnonzero(loops.flown & _within(known.flow.grid, loops))[:_RANDOM]
    return {
        "now": (twin.fly(None),),
        "waiting": (twin.fly(offered.picked([WAITING])),),
        "scouting": (twin.fly(offered.picked([SCOUTING])),),
        "planned": (twin.fly(best(())),),
        "closed ahead": (twin.fly(best((lane,))),),
        "random": tuple(twin.fly(loops.picked([k])) for k in usable),
    }


def _lane(stretch: Stretch) -> Ring:
    """Return a lane across the way ahead in which nothing surfaces: it begins 2 km ahead, and is 20 km wide and longer than the way."""
    ahead = (stretch.goals[0] - stretch.start) / abs(stretch.goals[0] - stretch.start)
    corners = stretch.start + ahead * np.array(
        [2e3 - 10e3j, 2e3 + 10e3j, 60e3 + 10e3j, 60e3 - 10e3j]
    )
    return Ring(np.column_stack([corners.real, corners.imag]), False, "lane", surface_only=True)


def _within(grid: Grid, survey: Survey) -> NDArray[np.bool_]:
    return np.asarray(inside_grid(grid, survey.corners.real, survey.corners.imag).all(axis=1))


def _drawn(
    grid: Grid, truth: Currents, speed: float, rng: np.random.Generator
) -> tuple[complex, complex]:
    """Return a start, and where most of the vehicle's speed in a direction leads in the truth after the survey's time [m]."""
    low, high = (np.array([pick(grid.east), pick(grid.north)]) for pick in (np.min, np.max))
    for _ in range(_DRAWS):
        east, north = rng.uniform(low, high)
        start, turn = complex(east, north), rng.uniform(0.0, 2.0 * np.pi)
        end = complex(
            fly(
                truth,
                np.array([start]),
                SURVEY,
                np.array([_SHARE * speed * np.exp(1j * turn)]),
                BLIND,
            )[-1, 0]
        )
        around = np.array([one + _EDGE * side for one in (start, end) for side in (1, -1, 1j, -1j)])
        calm = abs(truth.at(np.array([start]), 0.0)[0]) < 0.8 * speed
        if calm and abs(end - start) > 5e3 and np.all(inside_grid(grid, around.real, around.imag)):
            return start, end
    raise ForecastError(
        f"no stretch of {BLIND / 3600.0:g} h stays in the truth's water; give a larger region"
    )
