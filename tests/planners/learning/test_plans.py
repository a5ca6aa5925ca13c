"""Whole plans that learn: surveys, maps, and what is refused."""

from dataclasses import astuple, replace
from functools import partial

import numpy as np
import pytest

from planners import Glider
from planners.learning import maps, survey
from planners.learning.closed_loop import Stretch, drawn_sea
from planners.learning.comparison import lawn_mowers, realised
from planners.learning.mapping import (
    COUNTED,
    Mapping,
    _Search,
    _turned,
    legs_from,
    look_ahead,
    refined,
)
from planners.learning.maps import covariance_now, plan_map
from planners.learning.scene import scene_of, value_map
from planners.learning.survey import _words, plan_survey
from planners.learning.values import Box, Candidate, LearnRequest, LearnSettings, OtherProfiles
from replay_kit.core.errors import PlanError
from replay_kit.core.geodesy import to_local
from replay_kit.core.plan import Place
from tests.planners.flow_samples import forbidden, place
from tests.planners.learning.scenes import (
    DEPTH,
    HOUR,
    NOON,
    SPEED,
    random_waypoints,
    static,
    through_time,
)

GRID = static().grid
WIDE = np.stack(np.meshgrid([-15e3, 0.0, 15e3], [-10e3, 10e3]), axis=-1).reshape(-1, 2)
SETTINGS = LearnSettings(depth=DEPTH, samples=40, error=0.02)


spot = partial(place, static())
BOX = Box(*(side for at in ((-20e3, -15e3), (20e3, 15e3)) for side in astuple(spot(*at))[:2]))


def area(low, high, surface_only=False):
    return forbidden(static(), *low, *high, name="the lane", surface_only=surface_only)


def mapping_in(scene, box=WIDE):
    """What is to be mapped in a box by four profiles."""
    times = scene.leg_time * np.arange(5.0)
    return Mapping(scene.known, scene.mean, box, (0,), scene.start, times, scene.speed, 4e-4)


ASKED = LearnRequest(spot(-8e3, 0.0), (spot(8e3, 3e3),), Glider(), SETTINGS, start_time_ns=NOON)
#: four profiles of three dives each
DEEP = replace(ASKED, goals=(), profiles=4, settings=replace(SETTINGS, dives=3))
SURVEY, BLIND = 20.0 * HOUR, 20.0 * HOUR


@pytest.fixture(scope="module")
def planned():
    return plan_survey(static(), ASKED, SURVEY, BLIND)


def candidate(plan, name):
    return next(one for one in plan.candidates if one.name == name)


def test_a_survey_returns_and_its_stretch_ends_at_the_goal(planned):
    # its 90 % miss is kilometres
    assert planned.status == "uncertain"
    assert planned.duration == pytest.approx(SURVEY + BLIND)
    assert planned.after < 0.7 * planned.before
    blind = [leg for leg in planned.legs if leg.blind]
    back = to_local(GRID.projection, *planned.legs[-1 - len(blind)].ends_at)
    np.testing.assert_allclose(back, [-8e3, 0.0], atol=300.0)
    np.testing.assert_allclose(to_local(GRID.projection, *blind[-1].ends_at), [8e3, 3e3], atol=5.0)
    assert np.all(np.diff(planned.track_time) > 0.0)
    assert planned.track[:, 2].max() == DEPTH
    assert {"leaving now", "waiting as long", "scouting ahead and back", "this survey"} <= {
        one.name for one in planned.candidates
    }
    assert planned.after <= candidate(planned, "scouting ahead and back").predicted * 1.001
    assert candidate(planned, "this survey").found < candidate(planned, "leaving now").found
    assert planned.value.value.max() > 0.0
    # one profile is worth most on the way or near it, not at the region's edge
    best = np.argmax(planned.value.value)
    assert (
        abs(
            complex(
                *to_local(
                    GRID.projection, planned.value.longitude[best], planned.value.latitude[best]
                )
            )
        )
        < 20e3
    )


def test_a_lane_keeps_the_survey_out_and_lets_the_stretch_pass_below(planned):
    lane = area((-6e3, -9e3), (6e3, 9e3), surface_only=True)
    around = plan_survey(static(), replace(ASKED, no_go=(lane,)), SURVEY, BLIND)
    assert around.status == "uncertain"
    assert "scouting ahead and back" not in {one.name for one in around.candidates}
    assert around.after >= planned.after
    surfacings = np.array(
        [to_local(GRID.projection, *leg.ends_at) for leg in around.legs if not leg.blind]
    )
    assert not np.any((np.abs(surfacings[:, 0]) < 6e3) & (np.abs(surfacings[:, 1]) < 9e3))
    wall = plan_survey(
        static(), replace(ASKED, no_go=(area((-2e3, -9e3), (2e3, 9e3)),)), SURVEY, BLIND
    )
    assert (wall.status, "crosses the lane" in wall.message) == ("unsafe", True)


def test_the_status_is_that_of_the_share_of_the_samples_within_the_tolerance(planned):
    within = candidate(planned, "this survey").within
    assert within < 0.9
    assert (
        f"; {100.0 * within:.0f} % of {SETTINGS.samples} samples of the estimate end within the tolerance of 250 m, 90 %"
        in planned.message
    )
    easy = plan_survey(
        static(), replace(ASKED, settings=replace(SETTINGS, samples=20, arrive=0.0)), SURVEY, BLIND
    )
    assert (easy.status, "are asked for" in easy.message) == ("reached", False)
    for share, met in ((0.9 - 1e-12, True), (0.89, False)):
        assert (replace(easy.candidates[0], within=share).shortfall(SETTINGS) == "") is met


@pytest.mark.full
def test_a_stretch_whose_end_is_anywhere_is_refused_before_surveys_are_compared(monkeypatch):
    monkeypatch.setattr("planners.learning.survey._search", None)
    with pytest.raises(
        PlanError,
        match=r"300 h without fixes cannot be predicted: without a survey the stretch ends some \d+ km",
    ):
        plan_survey(static(), ASKED, SURVEY, 300.0 * HOUR)


def test_others_leave_less_to_learn(planned):
    taken = [leg.ends_at for leg in planned.legs if not leg.blind]
    others = OtherProfiles(*np.array(taken).T, np.full(len(taken), NOON))
    second = plan_survey(static(), replace(ASKED, others=others), SURVEY, BLIND)
    assert second.before < 0.8 * planned.before
    assert second.after < planned.after


@pytest.mark.parametrize(
    ("now", "waiting", "words"),
    [
        ((5.3, 4.3, 5.9), (6.4, 5.7, 7.4), "; leaving now misses less than after this survey"),
        ((6.3, 5.3, 6.9), (8.4, 7.7, 9.4), "; the survey is no certain gain over leaving now"),
        ((9.3, 8.3, 9.9), (6.5, 5.7, 7.4), "; the survey is no certain gain over waiting"),
        ((9.3, 8.3, 9.9), (8.4, 7.7, 9.4), ""),
    ],
)
def test_what_a_survey_gains_is_told_against_leaving_now_and_waiting(now, waiting, words):
    rows = (("leaving now", now), ("waiting as long", waiting), ("this survey", (6.2, 5.5, 7.0)))
    rows = tuple(
        Candidate(name, 0.0, *(1e3 * value for value in values), 0.0, name == "this survey")
        for name, values in rows
    )
    stretch = Stretch(0j, np.array([1e4 + 0j]), 0.0, 20 * HOUR, 20 * HOUR, SPEED, 0.0)
    assert _words(rows, stretch).endswith(f"this survey 6.2 km (5.5 to 7.0){words}")


@pytest.mark.full
def test_a_survey_in_a_sea_that_changes_is_less_sure_of_itself(monkeypatch):
    asked_at = list[float]()

    def noting(scene, aim, time, *more):
        asked_at.append(time)
        return value_map(scene, aim, time, *more)

    monkeypatch.setattr(survey, "value_map", noting)
    plan = plan_survey(
        through_time(), replace(ASKED, settings=replace(SETTINGS, samples=20)), SURVEY, BLIND
    )
    assert plan.after < plan.before
    assert candidate(plan, "this survey").found < candidate(plan, "leaving now").found
    # what a profile is worth is told for halfway through the survey
    assert asked_at == [pytest.approx(0.5 * SURVEY, rel=0.1)]


def test_a_map_is_no_worse_than_its_lawn_mowers_and_its_samples_say_so():
    asked = replace(DEEP, start=spot(-20e3, 0.0), profiles=5)
    plan = plan_map(static(), asked, BOX)
    assert plan.objective == "map"
    assert plan.after < plan.before
    assert plan.after <= candidate(plan, "the best lawn-mower").predicted * 1.001
    assert candidate(plan, "this plan").found == pytest.approx(plan.after, rel=0.25)
    assert candidate(plan, "no profiles").found == pytest.approx(plan.before, rel=0.25)
    assert len(plan.legs) == 5
    deep = plan_map(static(), asked, replace(BOX, depths=(60.0, 200.0)))
    assert np.isnan(candidate(deep, "this plan").found)
    assert "no errors in samples" in deep.notes[-1]
    assert deep.after < deep.before


def test_a_map_beside_another_s_profiles_has_its_errors_in_samples():
    theirs = [spot(east, north) for east in (-12e3, 12e3) for north in (-8e3, 8e3)]
    others = OtherProfiles(
        *np.array([[one.longitude, one.latitude] for one in theirs]).T, np.full(4, NOON)
    )
    asked = replace(DEEP, start=spot(-20e3, 0.0), profiles=3)
    alone, beside = (plan_map(static(), replace(asked, others=one), BOX) for one in (None, others))
    for name in ("no profiles", "this plan"):
        assert candidate(beside, name).found == pytest.approx(
            candidate(beside, name).predicted, rel=0.25
        )
        assert candidate(beside, name).found < candidate(alone, name).found
    assert beside.statistics["samples"] == SETTINGS.samples


def test_the_search_s_own_error_is_that_of_its_profiles():
    scene = scene_of(static(), DEEP, None)
    mapping = mapping_in(scene)
    survey = look_ahead(mapping, scene.allowed, covariance_now(scene, mapping))
    error = mapping.errors(survey)[0]
    better, found = refined(mapping, scene.allowed, survey, 0)
    assert found <= error * 1.01
    assert mapping.errors(better)[0] == pytest.approx(found)
    assert error < mapping.errors(random_waypoints(mapping, np.random.default_rng(0), 10)).mean()
    mowers = lawn_mowers(mapping)
    lengths = np.abs(np.diff(mowers.ends, axis=1, prepend=scene.start))
    assert lengths.max() < scene.leg_time * (SPEED + 0.3)
    sea = drawn_sea(scene.known, np.zeros(1), 30, 1)
    flown = ((mapping, survey),)
    assert (
        realised(sea, flown, np.zeros((30, 4, 2))).mean()
        < realised(sea, flown, np.zeros((30, 0, 2))).mean()
    )


def test_a_lawn_mower_that_no_survey_beats_is_chosen_and_said_to_be_one(monkeypatch):
    scene = scene_of(static(), DEEP, None)
    mapping = mapping_in(scene)
    errors = mapping.errors(lawn_mowers(mapping))
    for worse, is_mower in ((1.1, True), (0.9, False)):
        monkeypatch.setattr(
            maps,
            "refined",
            lambda mapping, allowed, one, seed, worse=worse: (one, worse * errors.min()),
        )
        survey, error, mower, mower_error, said = maps.choose_map(scene, mapping)
        assert said is is_mower
        assert mower_error == pytest.approx(errors.min())
        assert error == pytest.approx(errors.min() * (1.0 if is_mower else 0.9))
        assert (survey is mower) is is_mower


@pytest.mark.parametrize("changes", [False, True])
def test_what_a_search_leg_by_leg_gains_is_what_all_its_profiles_together_leave_less(
    changes, monkeypatch
):
    scene = scene_of(
        through_time() if changes else static(), replace(ASKED, goals=(), profiles=4), None
    )
    mapping = mapping_in(scene)
    ways, whole = [], _Search.next_ways
    monkeypatch.setattr(
        _Search, "next_ways", lambda search, *of: ways.append(whole(search, *of)) or ways[-1]
    )
    survey = look_ahead(mapping, scene.allowed, covariance_now(scene, mapping))
    gained = WIDE.size * (mapping.before() ** 2 - mapping.errors(survey)[0] ** 2)
    assert ways[-1][0].gained == pytest.approx(gained, rel=1e-6)
    # half a leg lies between the ways that are followed
    for step, followed in enumerate(ways):
        ends = np.array([way.place for way in followed])
        apart = np.abs(ends - ends[:, None])[~np.eye(len(ends), dtype=bool)]
        assert apart.min() >= 0.5 * mapping.speed * (mapping.times[step + 1] - mapping.times[step])


def test_legs_of_a_search_lead_in_all_directions_and_drift():
    scene = scene_of(static(), replace(ASKED, goals=(), profiles=4), None)
    mapping, starts = mapping_in(scene), scene.start + np.array([0.0, 2e3j])
    middles, ends = legs_from(mapping, starts, 1)
    lasts, time = mapping.times[2] - mapping.times[1], mapping.profile_times[1]
    drift = lasts * mapping.mean.at(starts[None], time)[0][:, None]
    held = ends - starts[:, None] - drift
    np.testing.assert_allclose(np.abs(held), COUNTED * mapping.speed * lasts)
    np.testing.assert_allclose(held[:, 1:] / held[:, :-1], np.exp(2j * np.pi / held.shape[1]))
    np.testing.assert_allclose(middles, 0.5 * (starts[:, None] + ends))


def test_the_profiles_of_a_search_are_made_in_the_middle_of_its_legs():
    scene = scene_of(static(), replace(ASKED, goals=(), profiles=4), None)
    mapping = mapping_in(scene, np.zeros((1, 2)))
    survey = look_ahead(mapping, scene.allowed, covariance_now(scene, mapping))
    begins = np.concatenate([[scene.start], survey.ends[0, :-1]])
    np.testing.assert_allclose(survey.profiles[0], 0.5 * (begins + survey.ends[0]), atol=1e-6)
    # the current that is known makes some of the way
    flown = np.abs(survey.ends[0] - begins) / scene.leg_time
    assert np.abs(flown - COUNTED * scene.speed).max() > 0.01


def test_a_survey_is_refined_from_its_own_legs(monkeypatch):
    scene = scene_of(static(), replace(ASKED, goals=(), profiles=4), None)
    mapping = mapping_in(scene, np.zeros((1, 2)))
    survey, turned = random_waypoints(mapping, np.random.default_rng(0), 1), []
    monkeypatch.setattr(
        "planners.learning.mapping._turned", lambda held, *_: turned.append(held) or held[None]
    )
    same, error = refined(mapping, lambda begins, ends: np.ones(ends.shape, dtype=bool), survey, 0)
    np.testing.assert_allclose(same.ends, survey.ends, atol=1e-6)
    assert error == pytest.approx(mapping.errors(survey)[0])
    assert len(turned) > 10


def test_a_leg_is_turned_and_in_half_of_the_tries_the_next_one_back():
    held = np.array([0.2 + 0.1j, 0.1 - 0.05j, -0.1 + 0.02j])
    tried = np.concatenate(
        [_turned(held, 0.5, np.random.default_rng(seed), 0.25) for seed in range(5)]
    )
    assert np.all(np.abs(tried) < 0.25 * (1.0 + 1e-9))
    angles = np.angle(tried / held)
    moved = np.abs(angles) > 1e-12
    assert set(moved.sum(axis=1)) == {1, 2}
    assert np.mean(moved[moved[:, :2].any(axis=1)].sum(axis=1) == 2) == pytest.approx(0.5, abs=0.12)
    assert np.mean(np.abs(np.abs(tried[moved]) - 0.25) < 1e-9) == pytest.approx(1 / 3, abs=0.12)
    for turn, which in zip(angles, moved, strict=True):
        first = int(np.argmax(which))
        assert which[first + 1 :].sum() == 0 or turn[first + 1] == pytest.approx(-turn[first])
    assert moved.any(axis=0).all()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"survey": 3.0 * HOUR}, "cannot return: it holds 1 surfacings"),
        ({"settings": replace(SETTINGS, tolerance=1e6)}, "no uncertainty is left to reduce"),
        ({"flow": static().mean_flow()}, "states no uncertainty"),
        ({"start": Place(0.0, 0.0, 0.0)}, "outside the forecast's region"),
        (
            {
                "no_go": (
                    area((-10e3, -2e3), (-9e3, 2e3)),
                    area((-7e3, -2e3), (-6e3, 2e3)),
                    area((-10e3, 1e3), (-6e3, 2e3)),
                    area((-10e3, -2e3), (-6e3, -1e3)),
                )
            },
            "areas",
        ),
    ],
)
def test_a_survey_that_makes_no_sense_is_refused(change, words):
    flow, survey = change.pop("flow", static()), change.pop("survey", SURVEY)
    if words == "areas":
        # boxed in: the shortest loops of a day do not fit
        with pytest.raises(PlanError, match="can leave and return"):
            plan_survey(flow, replace(ASKED, **change), survey, BLIND)
        return
    with pytest.raises(PlanError, match=words):
        plan_survey(flow, replace(ASKED, **change), survey, BLIND)


@pytest.mark.parametrize(
    ("box", "words"),
    [
        ((10.0, 50.0, 11.0, 51.0), "outside of the estimate's region"),
        ((152.2, -39.8, 152.5, -39.5, (5000.0,)), "expected depths"),
    ],
)
def test_a_box_that_makes_no_sense_is_refused(box, words):
    asked = replace(ASKED, goals=(), profiles=3)
    with pytest.raises(PlanError, match=words):
        plan_map(static(), asked, Box(*box))


def test_a_box_on_land_or_inside_out_is_refused():
    wet = GRID.wet.copy()
    wet[:, :, 6:] = False
    flow = replace(static(), grid=replace(GRID, wet=wet))
    east = float(GRID.longitude.max())
    with pytest.raises(PlanError, match="on land"):
        plan_map(
            flow, replace(ASKED, goals=(), profiles=3), Box(east - 0.2, -39.8, east - 0.05, -39.5)
        )
    with pytest.raises(PlanError, match="west below east"):
        Box(2.0, 0.0, 1.0, 1.0)
    with pytest.raises(PlanError, match="profiles of a map"):
        plan_map(flow, replace(ASKED, goals=()), Box(152.2, -39.8, 152.5, -39.5))
    with pytest.raises(PlanError, match="20 or more"):
        LearnSettings(samples=3)
    with pytest.raises(PlanError, match="error of a plan"):
        LearnSettings(error=0.0)
