"""A box that several vehicles survey together: the next profiles of all of them, chosen so that they leave the least error between them.

What profiles leave does not depend on their values, so that the vehicles are chosen one after another, each with the profiles of those
before it as given, and then each again beside all others while that helps. Each is chosen by the search of a single vehicle
(``learning/mapping.py``).

The variance that a set of profiles removes grows by less the more there are where errors do not suppress each other (Das and Kempe 2008,
Algorithms for subset selection in linear regression), which holds nearly for currents in a box. Then no plan removes more than this one
does and each of its profiles could remove once more from the best place within its vehicle's reach (Leskovec et al. 2007, Cost-effective
outbreak detection in networks, section 4): ``share_of_bound`` compares the plan with that.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular

from planners.learning.comparison import Flown, best_mower, compared
from planners.learning.loops import Survey
from planners.learning.mapping import Mapping, refined
from planners.learning.maps import (
    check_uncertain,
    choose_map,
    covariance_now,
    error_words,
    map_plan,
    mapping_of,
)
from planners.learning.rows import Rows, covariance, lower_root, rows_at, stacked
from planners.learning.scene import Scene
from planners.learning.values import Box, Candidate, LearnPlan, LearnRequest
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.depth_means import root_of
from replay_kit.core.flow.estimate import FlowEstimate

# Times that each survey is chosen again beside the others, and the least gain for another time.
_ROUNDS, _LEAST_GAIN = 3, 0.002
# Lines of the lattice on which the best place of one more profile is sought, along each side of the vehicles' reach.
_LINES = 40


@dataclass(frozen=True, slots=True, eq=False)
class JointSurvey:
    """Surveys of several vehicles.

    Attributes:
        plans: Of each vehicle, in the order of the requests; their errors are those after all surveys.
        before: Root mean square error of a component in the box without them [m/s].
        after: With them.
        candidates: What was compared: no profiles, lawn-mowers, each for itself, this plan.
        share_of_bound: Variance that the plan removes, as a share of a bound of what any plan could.
        flown: What each vehicle maps and flies in each of the candidates but the first, by their names.
    """

    plans: tuple[LearnPlan, ...]
    before: float
    after: float
    candidates: tuple[Candidate, ...]
    share_of_bound: float
    flown: dict[str, tuple[Flown, ...]]


@dataclass(frozen=True, slots=True, eq=False)
class _Surveys:
    """The vehicles, and a survey of each that has one."""

    scenes: tuple[Scene, ...]
    mappings: tuple[Mapping, ...]
    surveys: tuple[Survey, ...] = ()

    def beside(self, k: int) -> Mapping:
        """Return what vehicle k maps, with the surveys of all others as given."""
        mapping = self.mappings[k]
        given = mapping.given
        for one, survey in zip(self.mappings, self.surveys, strict=False):
            if one is not mapping:
                rows = _rows(one, survey)
                given = rows if given is None else stacked(rows, given)
        beside = replace(mapping, given=given)
        if given is None or mapping.known.changes:
            return beside
        # unknowns that do not change are as well known before the survey as after all others
        root = root_of(covariance_now(self.scenes[k], beside))
        return replace(beside, known=replace(mapping.known, root=root), given=None)

    def error(self) -> float:
        """Return the root mean square error after all surveys [m/s]."""
        return float(self.beside(0).errors(self.surveys[0])[0])

    def made(self, k: int, survey: Survey) -> "_Surveys":
        """Return them with a survey of vehicle k, the next one or in place of its former."""
        return replace(self, surveys=(*self.surveys[:k], survey, *self.surveys[k + 1 :]))

    @property
    def flown(self) -> tuple[Flown, ...]:
        """Each vehicle's map and survey."""
        return tuple(zip(self.mappings, self.surveys, strict=True))


def _rows(mapping: Mapping, survey: Survey) -> Rows:
    """Return the rows of a survey's profiles, shape (2 N,)."""
    return rows_at(mapping.known, survey.points[0], survey.times)


def plan_joint_survey(
    flow: FlowEstimate, requests: Sequence[LearnRequest], box: Box
) -> JointSurvey:
    """Return the profiles of several vehicles that together leave the least error of the current in a box.

    Args:
        flow: The estimate, with its uncertainty.
        requests: Of the vehicles: two or more with the same settings and number of profiles, which begin at the same time.
        box: Whose current counts.

    Raises:
        PlanError: The requests differ in more than the start, the box is outside or on land, no leg may be flown, or nothing is left to
            learn.
    """
    asked = {(one.settings, one.profiles, one.start_time_ns, one.vehicle) for one in requests}
    if len(requests) < 2 or len(asked) > 1:
        raise PlanError(
            "a joint survey: expected two vehicles or more with the same settings, profiles and start time; plan others with --others"
        )
    made = [mapping_of(flow, request, box) for request in requests]
    # places of the box and errors of the estimate are the same for all
    scenes, mappings = (
        tuple(replace(scene, known=made[0][0].known) for scene, _, _ in made),
        tuple(replace(mapping, known=made[0][1].known) for _, mapping, _ in made),
    )
    check_uncertain(scenes[0], mappings[0])
    none = _Surveys(scenes, mappings)
    alone, mowers, joint = none, none, none
    for k, scene in enumerate(scenes):
        alone = alone.made(k, choose_map(scene, mappings[k])[0])
        mowers = mowers.made(k, best_mower(scene, mowers.beside(k))[0])
        chosen = choose_map(scene, joint.beside(k))[0] if k else alone.surveys[0]
        joint = joint.made(k, chosen)
    joint = _again(joint)
    return _answer(requests, made[0][2], {"lawn-mowers": mowers, "each for itself": alone}, joint)


def _again(joint: _Surveys) -> _Surveys:
    """Return surveys that are refined beside each other while that helps."""
    error = joint.error()
    for turn in range(_ROUNDS):
        begun = error
        for k, scene in enumerate(joint.scenes):
            seed = scene.settings.seed + 1 + turn
            survey, found = refined(joint.beside(k), scene.allowed, joint.surveys[k], seed)
            if found < error:
                joint, error = joint.made(k, survey), found
        if error > (1.0 - _LEAST_GAIN) * begun:
            break
    return joint


def _answer(
    requests: Sequence[LearnRequest],
    notes: tuple[str, ...],
    others: dict[str, _Surveys],
    joint: _Surveys,
) -> JointSurvey:
    """Return the plans of all vehicles with what they were compared with."""
    before, after = joint.mappings[0].before(), joint.error()
    flown = {name: one.flown for name, one in {**others, "this plan": joint}.items()}
    predicted = {name: (_error_of(one), flown[name]) for name, one in others.items()}
    predicted |= {"this plan": (after, joint.flown)}
    candidates, more = compared(joint.scenes[0], {"no profiles": (before, ()), **predicted})
    share = share_of_bound(joint.mappings, joint.surveys)
    count = sum(request.profiles for request in requests)
    words = f"{error_words(count, before, after)}; " + ", ".join(
        f"{one.name} to {one.predicted:.3f}" for one in candidates[1:-1]
    )
    words += f"; at least {100.0 * share:.0f} % of the variance that any plan could remove"
    plans = tuple(
        map_plan(
            scene, (joint.beside(k), survey, after), candidates, request, words, (*notes, *more)
        )
        for k, (scene, survey, request) in enumerate(
            zip(joint.scenes, joint.surveys, requests, strict=True)
        )
    )
    return JointSurvey(plans, before, after, candidates, share, flown)


def _error_of(surveys: _Surveys) -> float:
    """Return the error that surveys leave [m/s]; infinite where one may not be flown."""
    for scene, mapping, survey in zip(
        surveys.scenes, surveys.mappings, surveys.surveys, strict=True
    ):
        begins = np.append(mapping.start, survey.ends[0, :-1])
        if not np.all(scene.allowed(begins, survey.ends[0])):
            return np.inf
    return surveys.error()


def share_of_bound(mappings: Sequence[Mapping], surveys: Sequence[Survey]) -> float:
    """Return the variance that surveys remove from the box, as a share of a bound of what any surveys of these vehicles could.

    Args:
        mappings: What is to be mapped as each vehicle has it, without the surveys.
        surveys: One of each.
    """
    first = mappings[0]
    measured = _rows(first, surveys[0])
    for mapping, survey in zip(mappings[1:], surveys[1:], strict=True):
        measured = stacked(_rows(mapping, survey), measured)
    if first.given is not None:
        measured = stacked(measured, first.given)
    removed = first.before() ** 2 - float(first.left_by(measured)) ** 2
    places, further = _lattice(mappings), 0.0
    times = first.profile_times
    for time in times if first.known.changes else times[:1]:
        gained = _one_more(first, measured, places, float(time))
        for mapping in mappings:
            for when in (float(time),) if first.known.changes else times:
                reach = _reach(mapping, float(when))
                near = np.hypot(*(places - [mapping.start.real, mapping.start.imag]).T) <= reach
                further += float(np.max(gained, initial=0.0, where=near))
    return removed / (removed + further)


def _reach(mapping: Mapping, time: float) -> float:
    """Return how far a vehicle can be from its start at a time [m], with the fastest current that is known."""
    box = (mapping.box[:, 0] + 1j * mapping.box[:, 1])[None]
    fastest = float(np.max(np.abs(mapping.mean.at(box, time))))
    return (mapping.speed + fastest) * (time - float(mapping.times[0]))


def _lattice(mappings: Sequence[Mapping]) -> Array:
    """Return places within the box and around the starts, shape (P, 2) [m]."""
    known = np.vstack([mappings[0].box, [(one.start.real, one.start.imag) for one in mappings]])
    axes = [
        np.linspace(low, high, _LINES) for low, high in zip(known.min(0), known.max(0), strict=True)
    ]
    return np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)


def _one_more(mapping: Mapping, measured: Rows, places: Array, time: float) -> Array:
    """Return by how much one more profile at each place reduces the mean variance in the box, shape (P,) [m^2/s^2]."""
    rows = rows_at(mapping.known, places[:, None], np.full(1, time))
    flat = rows.reshaped(2 * len(places))
    root = lower_root(measured, mapping.variance)
    at_places = solve_triangular(root, covariance(measured, flat), lower=True)
    at_box = solve_triangular(root, covariance(measured, mapping.sought), lower=True)
    crossed = (covariance(mapping.sought, flat) - at_box.T @ at_places).reshape(-1, len(places), 2)
    pairs = at_places.reshape(-1, len(places), 2)
    own = covariance(rows, rows) - np.einsum("qpa,qpb->pab", pairs, pairs)
    own += mapping.variance * np.eye(2)
    gain = np.einsum("mpa,pab,mpb->p", crossed, np.linalg.inv(own), crossed, optimize=True)
    return np.asarray(gain / len(crossed))
