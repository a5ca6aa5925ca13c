"""The study of plans that learn: surveys before a stretch without fixes, maps, and missions that surface, in withheld truths."""

from collections.abc import Sequence
from functools import partial

import numpy as np

from replay_kit.config.run import RunConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import ConfigError
from replay_kit.core.tasks import each_call
from replay_kit.studies.planning.job import PlanningJob, StudyReport
from replay_kit.studies.planning.learning_sea import DetourTwin, MapTwin, detour_twin, map_twin
from replay_kit.studies.planning.learning_twins import BEGINS, SurveyTwin, survey_twins
from replay_kit.studies.planning.pictures import draw_ways
from replay_kit.studies.planning.world import World
from replay_kit.studies.reports.tables import NAN, Cell, Criterion, Picture, Table, named_columns

NAME = "learn"
_HEADING = "Plans that learn"
_WAYS = ("now", "waiting", "scouting", "planned", "closed ahead", "random")
# What is required of surveys, of maps and of missions.
_WAITING, _RANDOM, _SCOUTING, _CLOSED, _INSIDE = 0.65, 0.8, 1.05, 0.85, (0.8, 0.95)
_MAP_RANDOM, _MOWER, _HALF, _PREDICTED, _LOSS = 0.9, 1.0, 0.9, 0.25, 0.01


def learn(world: World) -> StudyReport:
    """Return the outcome of plans that learn.

    Raises:
        ConfigError: The truth is no member of the ensemble.
    """
    members = tuple(
        withheld.case.member for withheld in world.truths if withheld.case.member is not None
    )
    if len(members) < len(world.truths):
        raise ConfigError(
            "--truth: the study learn leaves members out in turn; leave it out of --study"
        )
    job, series = world.job, world.series or (world.ensemble,)
    # maps and missions are of a sea that stays as it is then
    still = series[round(BEGINS * (len(series) - 1))]
    config = RunConfig(estimator=world.truths[0].config)
    surveys, maps, detours = list[SurveyTwin](), list[MapTwin](), list[DetourTwin]()
    turns = _in_turn(members, job.surveys)
    seeds = {
        member: [job.seed + k for k, one in enumerate(turns) if one == member] for member in turns
    }
    for found_twins in each_call(
        survey_twins, ((series, config, member, of_member) for member, of_member in seeds.items())
    ):
        for survey in found_twins:
            surveys.append(survey)
            world.advance(f"learn, survey, truth {survey.member}")
    halves = (
        (still, config, member, job.seed + k, k % 2 == 1)
        for k, member in enumerate(_in_turn(members, job.maps))
    )
    for found in each_call(map_twin, halves):
        maps.append(found)
        world.advance(f"learn, map, truth {found.member}")
    missions = (
        (still, config, member, job.seed + k)
        for k, member in enumerate(_in_turn(members, job.detours))
    )
    for flown in each_call(detour_twin, missions):
        detours.append(flown)
        world.advance(f"learn, mission, truth {flown.member}")
    return report_of(surveys, maps, detours)


def _in_turn(members: Sequence[int], count: int) -> list[int]:
    return [members[k % len(members)] for k in range(count)]


def misses_of(twins: Sequence[SurveyTwin], way: str) -> Array:
    """Return how far stretches ended from their goals after one kind of survey [m]."""
    return np.array([one.miss for twin in twins for one in twin.ways[way]])


def report_of(
    surveys: Sequence[SurveyTwin], maps: Sequence[MapTwin], detours: Sequence[DetourTwin]
) -> StudyReport:
    """Return the outcome of some twins of each kind."""
    ways = [_way_cells(surveys, way) for way in _WAYS if misses_of(surveys, way).size]
    by_way = {str(cells["before the stretch"]): cells for cells in ways}
    tables = [
        named_columns(
            f"{NAME}_surveys", "Ends of a stretch of 23 h without fixes, after 28 h", ways
        ),
        _each(surveys),
    ]
    tables.append(
        named_columns(
            f"{NAME}_maps",
            "Errors of the current in a box after 20 profiles",
            [_map_cells(one) for one in maps],
        )
    )
    tables.append(
        named_columns(
            f"{NAME}_missions",
            "Arrivals of missions that surface [h]",
            [_detour_cells(one) for one in detours],
        )
    )
    criteria = (
        *_survey_criteria(surveys, by_way),
        *_map_criteria(maps),
        *_detour_criteria(detours),
    )
    misses = {way: misses_of(surveys, way) / 1e3 for way in _WAYS if misses_of(surveys, way).size}
    caption = "Share of the stretches that end within a distance of their goals"
    picture = Picture(f"{NAME}_misses", caption, (7.0, 4.5), partial(draw_ways, misses))
    return StudyReport(
        NAME, _HEADING, tuple(tables), criteria, _findings(maps, detours), (picture,)
    )


def _ninety(values: Array) -> float:
    return float(np.quantile(values, 0.9)) if values.size else NAN


def _way_cells(twins: Sequence[SurveyTwin], way: str) -> dict[str, Cell]:
    misses = misses_of(twins, way)
    found = [one for twin in twins for one in twin.ways[way]]
    return {
        "before the stretch": way,
        "stretches": misses.size,
        "mean [m]": float(misses.mean()),
        "median [m]": float(np.median(misses)),
        "90 % [m]": _ninety(misses),
        "within 3 km": float(np.mean(misses <= 3e3)),
        "predicted rms [m]": float(np.sqrt(np.mean([one.predicted**2 for one in found]))),
        "rms [m]": float(np.sqrt(np.mean(misses**2))),
        "within the 90 % ellipse": float(np.mean([one.inside for one in found])),
    }


def _each(twins: Sequence[SurveyTwin]) -> Table:
    rows = [
        {
            "truth": twin.member,
            **{
                f"{way} [m]": float(np.mean([one.miss for one in twin.ways[way]] or [NAN]))
                for way in _WAYS
            },
        }
        for twin in twins
    ]
    return named_columns(f"{NAME}_twins", "Each twin's miss", rows)


def _map_cells(twin: MapTwin) -> dict[str, Cell]:
    return {
        "truth": twin.member,
        "half known": "yes" if twin.half_known else "no",
        "before [m/s]": twin.before,
        "planned [m/s]": twin.planned,
        "predicted [m/s]": twin.predicted,
        "lawn-mower [m/s]": twin.mower,
        "best lawn-mower in hindsight [m/s]": twin.hindsight,
        "random waypoints [m/s]": twin.random,
    }


def _detour_cells(twin: DetourTwin) -> dict[str, Cell]:
    return {
        "truth": twin.member,
        "straight [h]": twin.straight,
        "offered [h]": twin.offered,
        "best detour [h]": twin.detour,
        "gain in samples [h]": twin.gain,
        "offered a detour": "yes" if twin.pays else "no",
    }


def _survey_criteria(
    twins: Sequence[SurveyTwin], by_way: dict[str, dict[str, Cell]]
) -> tuple[Criterion, ...]:
    if not twins:
        return ()
    ninety = {way: _ninety(misses_of(twins, way)) for way in by_way}
    mean = {way: float(misses_of(twins, way).mean()) for way in by_way}
    within = float(np.mean([one.inside for twin in twins for one in twin.ways["planned"]]))
    return (
        Criterion(
            "90 % miss after the planned survey over that after waiting",
            ninety["planned"] / ninety["waiting"],
            at_most=_WAITING,
        ),
        Criterion(
            "the same over that after random loops",
            ninety["planned"] / ninety.get("random", NAN),
            at_most=_RANDOM,
        ),
        Criterion(
            "mean miss over that after scouting ahead",
            mean["planned"] / mean["scouting"],
            at_most=_SCOUTING,
        ),
        Criterion(
            "90 % miss with the way ahead closed over waiting",
            ninety["closed ahead"] / ninety["waiting"],
            at_most=_CLOSED,
        ),
        Criterion(
            "share of the ends within the ellipse of 90 %",
            within,
            at_least=_INSIDE[0],
            at_most=_INSIDE[1],
        ),
    )


def _map_criteria(maps: Sequence[MapTwin]) -> tuple[Criterion, ...]:
    whole, half = ([one for one in maps if one.half_known is known] for known in (False, True))
    found = []
    if whole:
        found += [
            Criterion(
                "error of a map over that of random waypoints, mean",
                _ratio(whole, "planned", "random"),
                at_most=_MAP_RANDOM,
            ),
            Criterion(
                "the same over that of the best lawn-mower",
                _ratio(whole, "planned", "mower"),
                at_most=_MOWER,
            ),
        ]
    if half:
        found.append(
            Criterion(
                "the same, a half of the box known", _ratio(half, "planned", "mower"), at_most=_HALF
            )
        )
    if maps:
        off = abs(_ratio(maps, "predicted", "planned") - 1.0)
        found.append(
            Criterion(
                "difference of the predicted from the realised error of a map",
                off,
                at_most=_PREDICTED,
            )
        )
    return tuple(found)


def _ratio(maps: Sequence[MapTwin], first: str, second: str) -> float:
    """Return the ratio of root mean square errors over maps."""
    one, other = (
        np.sqrt(np.mean([getattr(twin, name) ** 2 for twin in maps])) for name in (first, second)
    )
    return float(one / other)


def _detour_criteria(detours: Sequence[DetourTwin]) -> tuple[Criterion, ...]:
    if not detours:
        return ()
    return (
        Criterion(
            "mean loss of what is offered against going straight",
            _loss(detours, "offered"),
            at_most=_LOSS,
        ),
    )


def _loss(detours: Sequence[DetourTwin], name: str) -> float:
    return float(np.mean([getattr(one, name) / one.straight - 1.0 for one in detours]))


def _findings(maps: Sequence[MapTwin], detours: Sequence[DetourTwin]) -> tuple[str, ...]:
    found = []
    if maps:
        found.append(
            f"In hindsight, a map's error is {_ratio(maps, 'planned', 'hindsight'):.2f} of that of the lawn-mower that turned out best."
        )
    if detours:
        offered = sum(one.pays for one in detours)
        found.append(
            f"A detour is offered in {offered} of {len(detours)} missions. The best detour of each, flown whether offered or not, arrives "
            f"{_loss(detours, 'detour'):+.1%} later than going straight; what is offered {_loss(detours, 'offered'):+.1%}."
        )
    return tuple(found)


def learning_calls(job: PlanningJob) -> int:
    """Return the number of twins of a job."""
    return job.surveys + job.maps + job.detours
