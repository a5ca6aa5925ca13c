"""Twins of maps and of missions that surface: a member left out is the truth, its copies are left out with it, and the sea stays as it is.

Profiles are reduced to their mean currents, which replace the whole update within 3 %.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planners import Glider
from planners.front.current import shares_of_levels
from planners.learning.closed_loop import Sea, mean_currents
from planners.learning.current import currents_of
from planners.learning.detours import compare, voyage_of
from planners.learning.loops import Survey
from planners.learning.mapping import Mapping
from planners.learning.maps import choose_map, realised
from planners.learning.mowers import lawn_mowers, random_waypoints
from planners.learning.scene import Scene, scene_of
from planners.learning.values import LearnRequest, LearnSettings
from planners.learning.ways import fly_voyage
from replay_kit.config.run import RunConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import ForecastError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import inside_grid
from replay_kit.core.grid import Ensemble, Grid
from replay_kit.studies.missions.scene import own_estimator, withhold
from replay_kit.studies.planning.learning_twins import DEPTH, ERROR, profiles_of, without
from replay_kit.studies.planning.voyages import sea_of
from replay_kit.studies.twins.field import build_field
from replay_kit.studies.twins.reachable import SPEED, place_at

#: Profiles of a map, dives of one of its legs, half its box's sides [m], and profiles that are known of one half of it.
PROFILES, DIVES, HALF, KNOWN = 20, 3, (70e3, 50e3), 8
# Random ways through a box; distance of a mission's goal [m], dives of its legs, and samples of its evidence.
_RANDOM, _DISTANCE, _YOS, _SAMPLES = 20, (60e3, 90e3), 2, 40
_EDGE, _DRAWS = 15e3, 300


@dataclass(frozen=True, slots=True)
class MapTwin:
    """The errors of one truth's current in a box [m/s].

    Attributes:
        member: The truth, position from 0.
        half_known: Whether one half of the box was known before.
        before: Without the profiles.
        planned: After those of the plan.
        predicted: What was predicted of them.
        mower: After those of the lawn-mower of the least predicted error.
        hindsight: After those of the lawn-mower that turned out best.
        random: After those of random ways, their mean.
    """

    member: int
    half_known: bool
    before: float
    planned: float
    predicted: float
    mower: float
    hindsight: float
    random: float


@dataclass(frozen=True, slots=True)
class DetourTwin:
    """Arrivals of one mission [h].

    Attributes:
        member: The truth, position from 0.
        straight: Going straight.
        offered: By what is offered.
        detour: By the best detour, offered or not.
        gain: Hours that samples expect of the detour.
        pays: Whether it is offered.
    """

    member: int
    straight: float
    offered: float
    detour: float
    gain: float
    pays: bool


def _left_out(
    ensemble: Ensemble, config: RunConfig, member: int, given: Callable[[Grid], Array] | None = None
) -> tuple[FlowEstimate, FlowEstimate, NDArray[np.float64]]:
    """Return an estimate that does not know a member, after profiles at places, the truth, and the noise's seed as an array."""
    kept, position = without((ensemble,), member)
    case = withhold(kept, position)
    estimator = own_estimator(case, config)
    truth, state = sea_of(case.truths, config.estimator)[0], estimator.initial()
    rng = np.random.default_rng((member, 1))
    if given is not None:
        points = given(truth.grid)
        places = points[:, 0] + 1j * points[:, 1]
        for after, _ in estimator.steps(
            state, profiles_of(build_field(*case.truths), places, np.zeros(len(points)), 0, rng)
        ):
            state = after
    return estimator.flow(state), truth, rng.standard_normal((1, PROFILES * 20, 2))


def _sea(scene: Scene, truth: FlowEstimate) -> Sea:
    weights = shares_of_levels(truth, DEPTH, 0.0)
    times = np.zeros(1)
    return Sea(
        scene.known,
        times,
        mean_currents(scene.known, times),
        currents_of(truth, [(truth.latent @ weights)[None]], times),
    )


def map_twin(
    ensemble: Ensemble, config: RunConfig, member: int, seed: int, half_known: bool
) -> MapTwin:
    """Return one twin of a map.

    Raises:
        ForecastError: The region is too small for the box.
    """
    rng = np.random.default_rng((seed, member))
    centre, start = _box_drawn(ensemble.grid, rng)

    def of_half(grid: Grid) -> Array:
        return centre + rng.uniform([-HALF[0], -HALF[1]], [0.0, HALF[1]], (KNOWN, 2))

    flow, truth, noise = _left_out(ensemble, config, member, of_half if half_known else None)
    settings = LearnSettings(depth=DEPTH, dives=DIVES, error=ERROR, seed=seed)
    request = LearnRequest(
        place_at(ensemble.grid, start), (), Glider(SPEED), settings, profiles=PROFILES
    )
    scene = scene_of(flow, request, None)
    box = (
        np.stack(
            np.meshgrid(np.linspace(-HALF[0], HALF[0], 11), np.linspace(-HALF[1], HALF[1], 8)),
            axis=-1,
        ).reshape(-1, 2)
        + centre
    )
    times: Array = scene.leg_time * np.arange(PROFILES + 1, dtype=np.float64)
    mapping = Mapping(scene.known, scene.mean, box, (0,), scene.start, times, scene.speed, ERROR**2)
    survey, predicted, mower, _, _ = choose_map(scene, mapping)
    sea, mowers, loops = (
        _sea(scene, truth),
        lawn_mowers(mapping),
        random_waypoints(mapping, rng, _RANDOM),
    )
    noise = noise[:, :PROFILES]

    def error(of: Survey | None) -> float:
        return float(realised(sea, mapping, of, noise)[0])

    free = np.all(inside_grid(ensemble.grid, mowers.ends.real, mowers.ends.imag), axis=1)
    return MapTwin(
        member,
        half_known,
        error(None),
        error(survey),
        predicted,
        error(mower),
        min(error(mowers.picked([int(k)])) for k in np.flatnonzero(free)),
        float(np.mean([error(loops.picked([k])) for k in range(_RANDOM)])),
    )


def detour_twin(ensemble: Ensemble, config: RunConfig, member: int, seed: int) -> DetourTwin:
    """Return one twin of a mission that surfaces and is planned anew.

    Raises:
        ForecastError: The region is too small.
    """
    rng = np.random.default_rng((seed, member, 2))
    flow, truth, noise = _left_out(ensemble, config, member)
    settings = LearnSettings(depth=DEPTH, dives=_YOS, error=ERROR, samples=_SAMPLES, seed=seed)
    late = 0.0
    for _ in range(_DRAWS):
        start, goal = _pair(ensemble.grid, rng)
        request = LearnRequest(
            place_at(ensemble.grid, start),
            (place_at(ensemble.grid, goal),),
            Glider(SPEED),
            settings,
        )
        scene = scene_of(flow, request, None)
        voyage, sea = voyage_of(scene), _sea(scene, truth)
        late = voyage.most * voyage.leg_time
        straight = float(fly_voyage(sea, voyage, noise)[0])
        # goals out of reach in the truth say nothing of detours
        if straight < late:
            break
    else:
        raise ForecastError("no goal within reach of the truth was found; give a larger region")
    evidence = compare(scene, voyage)
    detour = (
        float(fly_voyage(sea, voyage, noise, evidence.via)[0])
        if evidence.via != voyage.start
        else straight
    )
    offered = detour if evidence.pays else straight
    return DetourTwin(
        member, straight / 3600.0, offered / 3600.0, detour / 3600.0, evidence.gain, evidence.pays
    )


def _box_drawn(grid: Grid, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return the centre of a box within the region, and a start at its side, shape (2,) [m]."""
    low, high = (np.array([pick(grid.east), pick(grid.north)]) for pick in (np.min, np.max))
    for _ in range(_DRAWS):
        centre = rng.uniform(low, high)
        corners = centre + np.array(
            [[i * (HALF[0] + _EDGE), j * (HALF[1] + _EDGE)] for i in (-1, 1) for j in (-1, 1)]
        )
        if np.all(inside_grid(grid, *corners.T)):
            return centre, centre + np.array([-HALF[0], rng.uniform(-HALF[1], HALF[1])])
    raise ForecastError("the region holds no box of 140 by 100 km; give a larger region")


def _pair(grid: Grid, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return a start and a goal within the region, shape (2,) [m]."""
    low, high = (np.array([pick(grid.east), pick(grid.north)]) for pick in (np.min, np.max))
    for _ in range(_DRAWS):
        start, turn, far = (
            rng.uniform(low, high),
            rng.uniform(0.0, 2.0 * np.pi),
            rng.uniform(*_DISTANCE),
        )
        ends = np.stack([start, start + far * np.array([np.cos(turn), np.sin(turn)])])
        around = np.concatenate(
            [
                ends + _EDGE * np.array(side)
                for side in ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))
            ]
        )
        if np.all(inside_grid(grid, *around.T)):
            return ends[0], ends[1]
    raise ForecastError("the region holds no mission of 60 km; give a larger region")
