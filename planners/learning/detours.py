"""Whether a detour that learns pays for a mission that surfaces and is planned anew: evidence from samples, and mostly a refusal."""

from dataclasses import dataclass

import numpy as np

from planners.learning.arrival import arrival_sensitivity, arrive
from planners.learning.choose import Aim
from planners.learning.closed_loop import Sea, drawn_sea, slices
from planners.learning.current import Complex
from planners.learning.rows import rows_at
from planners.learning.scene import LONGEST, Scene, dives_of, scene_of, value_map
from planners.learning.values import Candidate, LearnPlan, LearnRequest
from planners.learning.ways import Voyage, fly_voyage
from replay_kit.core.arrays import Array
from replay_kit.core.bootstrap import bootstrap_interval
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.estimate import FlowEstimate

# Samples among which detours are chosen, and standard errors that a gain must exceed.
_CHOOSING, _ERRORS = 16, 2.0
# Places that detours pass: shares of the way along and across.
_ALONG, _ACROSS = (0.25, 0.5), (0.12, -0.12, 0.3, -0.3)
_RESAMPLES = 400


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What samples say of detours.

    Attributes:
        straight: Arrivals [s] going straight, shape (S,), in fresh samples.
        unlearnt: Going straight without using what is measured.
        detour: By the best detour.
        via: The place that it passes [m].
        gain: Mean hours that it saves.
        standard_error: Of that.
    """

    straight: Array
    unlearnt: Array
    detour: Array
    via: complex
    gain: float
    standard_error: float

    @property
    def pays(self) -> bool:
        """Whether the detour's gain exceeds two standard errors."""
        return self.gain > _ERRORS * self.standard_error


def compare(scene: Scene, voyage: Voyage) -> Evidence:
    """Return what samples of the estimate say of detours: the best is chosen in some and judged in others."""
    span = slices(scene.known, scene.begin, scene.begin + voyage.most * voyage.leg_time)
    choosing = drawn_sea(scene.known, span, _CHOOSING, scene.settings.seed + 1)
    noise = _noise(choosing, voyage, scene.settings.seed + 2)
    straight = fly_voyage(choosing, voyage, noise)
    places = vias(scene, voyage)
    means = [float(np.mean(fly_voyage(choosing, voyage, noise, via) - straight)) for via in places]
    fresh = drawn_sea(scene.known, span, scene.settings.samples, scene.settings.seed + 3)
    noise = _noise(fresh, voyage, scene.settings.seed + 4)
    straight, unlearnt = (
        fly_voyage(fresh, voyage, noise),
        fly_voyage(fresh, voyage, noise, learns=False),
    )
    if not places.size:
        return Evidence(straight, unlearnt, straight, voyage.start, 0.0, 0.0)
    via = complex(places[int(np.argmin(means))])
    detour = fly_voyage(fresh, voyage, noise, via)
    saved = (straight - detour) / 3600.0
    return Evidence(
        straight,
        unlearnt,
        detour,
        via,
        float(saved.mean()),
        float(saved.std(ddof=1) / np.sqrt(saved.size)),
    )


def vias(scene: Scene, voyage: Voyage) -> Complex:
    """Return places that detours pass, shape (n,) [m], that may be reached straight from the start and left straight to the goal."""
    way = voyage.goal - voyage.start
    places = np.array(
        [voyage.start + way * complex(along, across) for along in _ALONG for across in _ACROSS]
    )
    there = scene.allowed(np.full(places.size, voyage.start), places)
    back = scene.allowed(places, np.full(places.size, voyage.goal))
    return np.asarray(places[there & back])


def _noise(sea: Sea, voyage: Voyage, seed: int) -> Array:
    return np.random.default_rng(seed).standard_normal((sea.count, voyage.most, 2))


def voyage_of(scene: Scene) -> Voyage:
    """Return the mission of a scene to its last goal."""
    way = abs(complex(scene.goals[-1]) - scene.start)
    most = max(int(np.ceil(LONGEST * way / scene.speed / scene.leg_time)), 3)
    return Voyage(
        scene.start,
        complex(scene.goals[-1]),
        scene.begin,
        scene.speed,
        scene.leg_time,
        most,
        scene.settings.error,
    )


def plan_detour(flow: FlowEstimate, request: LearnRequest) -> LearnPlan:
    """Return whether a detour that learns pays before a goal, with the evidence: going straight where it does not.

    Args:
        flow: The estimate, with its uncertainty.
        request: Start and one goal.

    Raises:
        PlanError: A place is outside, on land or forbidden, the goal is out of reach, or there are several goals.
    """
    if len(request.goals) != 1:
        raise PlanError(
            f"expected one goal, got {len(request.goals)}; for a stretch without fixes past several places use --then"
        )
    scene = scene_of(flow, request, None)
    voyage = voyage_of(scene)
    if abs(voyage.goal - voyage.start) <= scene.speed * scene.leg_time:
        raise PlanError(
            "the goal is less than a surfacing away: nothing that is learnt on a detour can be used; choose a farther goal"
        )
    found = arrive(scene.mean, voyage.start, scene.begin, voyage.goal, voyage.speed)
    evidence = compare(scene, voyage)
    sense = arrival_sensitivity(scene.mean, voyage.start, scene.begin, found)
    rows = rows_at(
        scene.known, np.stack([sense.points.real, sense.points.imag], axis=-1), sense.times
    )
    aim = scene.aim(rows.combined(sense.weights / 3600.0))
    corners = np.array([evidence.via, voyage.goal]) if evidence.pays else np.array([voyage.goal])
    return _plan(scene, request, (voyage, aim, corners), evidence)


def _plan(
    scene: Scene, request: LearnRequest, asked: tuple[Voyage, Aim, Complex], evidence: Evidence
) -> LearnPlan:
    voyage, aim, corners = asked
    ends, times = _surfacings(scene, voyage, corners)
    legs, track_time, track = dives_of(scene, voyage.start, ends, times)
    rows = [
        ("straight ahead", evidence.straight, not evidence.pays),
        ("straight ahead, nothing learnt", evidence.unlearnt, False),
    ]
    if evidence.via != voyage.start:
        rows.append(("the best detour", evidence.detour, evidence.pays))
    late = voyage.most * voyage.leg_time
    candidates = tuple(
        Candidate(name, np.nan, *_hours(arrivals), float(np.mean(arrivals < late)), chosen)
        for name, arrivals, chosen in rows
    )
    miss = float(abs(ends[-1] - voyage.goal))
    reached = miss <= scene.settings.tolerance
    rare = (
        next(one for one in candidates if one.chosen).shortfall(scene.settings, "arrive")
        if reached
        else ""
    )
    unreached = "" if reached else f"; the goal is {miss / 1e3:.1f} km out of reach"
    return LearnPlan(
        status="unreachable" if unreached else "uncertain" if rare else "reached",
        message=_words(scene, evidence, request.settings.samples) + unreached + rare,
        objective="mission",
        request=request,
        goal=request.goals[-1],
        depth=scene.settings.depth,
        legs=legs,
        track_time=track_time,
        track=track,
        miss=miss,
        before=aim.before(),
        after=aim.before(),
        candidates=candidates,
        value=value_map(
            scene,
            aim,
            scene.begin + 0.5 * scene.leg_time,
            np.array([voyage.start, voyage.goal]),
            "h",
        ),
        found_name="mean arrival",
        unit="h",
        figures={
            "gain_h": evidence.gain,
            "gain_standard_error_h": evidence.standard_error,
            "learnt_going_straight_h": float(np.mean(evidence.unlearnt - evidence.straight))
            / 3600.0,
            "samples": request.settings.samples,
        },
    )


def _words(scene: Scene, evidence: Evidence, samples: int) -> str:
    """Return the answer in words."""
    learnt = float(np.mean(evidence.unlearnt - evidence.straight)) / 3600.0
    anyway = (
        f"what going straight measures anyway saves {learnt:.1f} h in the mean of {samples} samples"
    )
    if evidence.via == scene.start:
        return f"go straight: no detour keeps clear of land, areas and the edge of the region; {anyway}"
    against = f"{evidence.gain:+.1f} h saved, with a standard error of {evidence.standard_error:.1f} h, in {samples} fresh samples"
    if evidence.pays:
        return f"the detour pays: {against}; {anyway}"
    return f"go straight: no detour pays (the best of those tried: {against}; more than two standard errors are asked for); {anyway}"


def _hours(arrivals: Array) -> tuple[float, float, float]:
    """Return mean arrivals [h] and an interval that holds them with a probability of 90 %, by bootstrap."""
    hours = arrivals / 3600.0
    return float(hours.mean()), *bootstrap_interval(
        lambda drawn: hours[drawn].mean(axis=1), hours.size, _RESAMPLES
    )


def _surfacings(scene: Scene, voyage: Voyage, corners: Complex) -> tuple[Complex, Array]:
    """Return where legs past corners end in the current that is known, shape (n,) [m], and times [s] from the start on, shape (n + 1,)."""
    place, time, ends, times, corner = (
        voyage.start,
        voyage.begin,
        list[complex](),
        [voyage.begin],
        0,
    )
    while corner < corners.size and len(ends) < voyage.most:
        way = complex(corners[corner]) - place
        unit = way / max(abs(way), 1e-9)
        u = complex(scene.mean.at(np.array([place]), time)[0]) * np.conj(unit)
        over_ground = np.sqrt(max(voyage.speed**2 - u.imag**2, 0.0)) + u.real
        if over_ground <= 0.0:
            break
        spent = min(voyage.leg_time, abs(way) / over_ground)
        place, time = place + unit * over_ground * spent, time + spent
        corner += spent < voyage.leg_time
        ends.append(place)
        times.append(time)
    return np.array(ends), np.array(times)
