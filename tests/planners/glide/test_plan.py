"""Plans: analytic cases, an exhaustive search, what cannot be reached, what cannot be asked."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from planners import Bathymetry, GlideSettings, fly, plan
from planners.glide import solve
from planners.glide.candidate import Candidate, fly_candidate
from planners.glide.seeds import find_seeds, tabulate
from planners.glide.solve import _remaining, explain
from planners.glide.transcription import Glide, GlideTask
from planners.hazards.domain import Region
from planners.track import fly_glide, fractions_of_duration
from replay_kit.core.errors import PlanError
from replay_kit.core.geodesy import to_geographic, true_north_halfway
from replay_kit.core.plan import Place
from tests.planners.flow_samples import eddying_flow, place, still_flow, uniform_flow
from tests.reference.planner import exhaustive_closest_approach

SETTINGS = GlideSettings()


def _same(a, b):
    arrays = all(
        np.array_equal(getattr(a, name), getattr(b, name))
        for name in ("track", "track_time", "velocity_through_water")
    )
    numbers = all(
        getattr(a, name) == getattr(b, name)
        for name in ("status", "heading_deg", "glide_angle_deg", "duration", "closest_approach")
    )
    return arrays and numbers and a.message == b.message and a.statistics == b.statistics


@pytest.mark.parametrize(
    ("goal", "begin"),
    [
        ((15e3, 8e3, 300.0), 0.0),
        ((-9e3, 12e3, 20.0), 350.0),
        ((12e3, -9e3, 60.0), 60.0),
        ((0.0, 500.0, 390.0), 0.0),
    ],
)
def test_still_water_is_crossed_in_a_straight_line(goal, begin):
    flow = still_flow()
    start = place(flow, -2e3, 1e3, begin)
    result = plan(flow, start, place(flow, *goal))
    way = np.array(goal) - [-2e3, 1e3, begin]
    # a compass holds the heading: true north halfway
    north = float(
        true_north_halfway(flow.grid.projection, np.array([[-2e3, 1e3]]), np.array([goal[:2]]))[0]
    )
    assert result.status == "reached"
    assert result.closest_approach < 0.1
    assert result.duration == pytest.approx(np.linalg.norm(way) / 0.3, rel=1e-4)
    assert result.glide_angle_deg == pytest.approx(
        np.rad2deg(np.arcsin(way[2] / np.linalg.norm(way))), abs=1e-2
    )
    assert result.heading_deg == pytest.approx(
        np.rad2deg(np.arctan2(way[0], way[1]) - north) % 360.0, abs=1e-2
    )
    np.testing.assert_allclose(
        result.velocity_through_water, 0.3 * way / np.linalg.norm(way), atol=1e-4
    )
    assert len(result.track) >= 100
    assert result.track_time[-1] == result.duration


def test_uniform_current_is_headed_off():
    flow = uniform_flow(0.1, -0.05)
    result = plan(flow, place(flow, -10e3, 0.0), place(flow, 5e3, 6e3, 300.0))
    assert result.status == "reached"
    through_water = np.array([15e3, 6e3, 300.0]) / result.duration - [0.1, -0.05, 0.0]
    np.testing.assert_allclose(result.velocity_through_water, through_water, atol=1e-3)


@pytest.mark.full
@pytest.mark.parametrize(
    ("seed", "longest"),
    [
        (1, 1.2e5),
        pytest.param(3, 1.2e5, marks=pytest.mark.full),
        pytest.param(7, 3e4, marks=pytest.mark.full),
    ],
)
def test_as_close_as_an_exhaustive_search(seed, longest):
    flow = eddying_flow(seed, "gaussian" if seed == 1 else "hat", speed=0.25)
    rng = np.random.default_rng(seed)
    begin = np.array([*rng.uniform(-2e4, 2e4, 2), 0.0])
    goal = np.array([*rng.uniform(-2.5e4, 2.5e4, 2), rng.uniform(50.0, 380.0)])
    found = plan(
        flow,
        place(flow, *begin),
        place(flow, *goal),
        settings=replace(SETTINGS, max_duration=longest),
    )
    searched = exhaustive_closest_approach(
        flow, begin, goal, 0.3, longest, headings=72, times=24, steps=12
    )
    # where there is time enough the search itself has to meet the goal, or to be as close would be easy
    assert (searched < 1.0) == (longest == 1.2e5)
    assert found.closest_approach <= searched + 10.0


@pytest.mark.parametrize("beside", ["edge", "coast"])
def test_a_start_beside_an_edge_or_a_coast_leaves_it(beside):
    flow = still_flow()
    grid, wet = flow.grid, flow.grid.wet.copy()
    wet[:, 3, :] = beside == "edge"
    region = Region(replace(grid, wet=wet))
    # 100 m from where water ends, and the nearest point of the table of the flow is beyond
    start = np.array(
        [
            grid.east[0, 5],
            grid.north[0, 5] + 100.0 if beside == "edge" else grid.north[3:5, 5].mean() + 100.0,
            0.0,
        ]
    )
    goal = start + np.array([2e3, 11e3, 200.0])
    assert not tabulate(flow, region).allowed_at(start[None] - [[0.0, 200.0, 0.0]])[0]
    seed = find_seeds(GlideTask(flow, region, start, goal, GlideSettings(max_duration=2e5)), 1)[0]
    # the fan's headings are four degrees apart
    assert seed.distance < np.deg2rad(2.0) * 11.2e3 + 50.0
    assert seed.glide.duration == pytest.approx(11.2e3 / 0.3, rel=0.02)


@pytest.mark.parametrize("seed", [10, 11, pytest.param(12, marks=pytest.mark.full)])
def test_never_worse_than_the_seed_and_true_to_a_finer_flight(seed):
    flow = eddying_flow(seed)
    result = plan(flow, place(flow, -2e4, -1e4), place(flow, 1.5e4, 1.2e4, 200.0))
    assert result.closest_approach <= result.statistics["best_seed_distance"] + 0.01
    assert abs(result.closest_approach - float(result.statistics["solver_distance"])) < 1.0
    fractions = fractions_of_duration(0.0, result.track[-1, 2], flow.levels, 2000)
    fine = fly_glide(
        flow, result.track[0], result.velocity_through_water, fractions * result.duration
    )
    np.testing.assert_allclose(fine.position[-1], result.track[-1], atol=1.0)


def _distance_only(flow, **settings):
    return plan(
        flow,
        place(flow, -2e4, 0.0),
        place(flow, 2e4, 0.0, 300.0),
        settings=replace(SETTINGS, **settings),
    )


def test_too_far_is_unreachable_and_says_so():
    result = _distance_only(still_flow(), max_duration=3e4)
    assert result.status == "unreachable"
    assert result.closest_approach == pytest.approx(np.hypot(4e4, 300.0) - 0.3 * 3e4, abs=1.0)
    assert "max_duration = 30000 s" in result.message


def test_a_stronger_current_is_unreachable_and_says_so():
    flow = uniform_flow(-0.6, 0.0)
    result = plan(flow, place(flow, 0.0, 0.0), place(flow, 2e4, 0.0, 300.0))
    assert result.status == "unreachable"
    assert "current" in result.message


def test_an_outcome_beyond_the_region_stops_at_its_edge():
    flow = uniform_flow(0.0, 0.5)
    north = flow.grid.north.max()
    result = plan(flow, place(flow, -15e3, north - 10e3), place(flow, 20e3, north - 4e3, 200.0))
    assert result.status == "unreachable"
    assert result.track[:, 1].max() <= north + 1.0
    assert "region" in result.message
    # what the optimiser promises within the region is what is flown; without the region it would promise kilometres more
    assert abs(result.closest_approach - float(result.statistics["solver_distance"])) < 1.0


@pytest.mark.parametrize(
    ("end", "goal", "limit"),
    [
        (398.0, 300.0, "the deepest level, 400 m"),
        (2.0, 300.0, "the surface"),
        (398.0, 399.0, "the current, 0.10 m/s along the path"),
        (2.0, 3.0, "the current, 0.10 m/s along the path"),
    ],
)
def test_the_deepest_level_and_the_surface_limit_a_goal_that_is_not_at_them(end, goal, limit):
    flow = uniform_flow(0.1, 0.0)
    begin, through = np.array([0.0, 0.0, 200.0]), np.array([0.1, 0.0, (end - 200.0) / 1e4])
    track = fly_glide(flow, begin, through, np.linspace(0.0, 1e4, 20))
    task = GlideTask(flow, Region(flow.grid), begin, np.array([9e3, 0.0, goal]), SETTINGS)
    flown = Candidate(Glide(0.0, 0.0, 1e4), 1e4, 1e4, 7e3, track)
    assert limit in explain(task, flown, 7e3, "unreachable")


@pytest.mark.full
def test_land_is_not_crossed():
    flow = still_flow()
    wet = flow.grid.wet.copy()
    wet[:, :, 5] = False
    wet[:, 0, 5] = True
    dry = replace(flow, grid=replace(flow.grid, wet=wet))
    result = plan(dry, place(dry, -2e4, 0.0), place(dry, 2e4, 5e3, 300.0))
    assert result.status == "unreachable"
    assert result.track[:, 0].max() < 0.0
    assert "land" in result.message


def test_a_flow_that_is_not_a_number_fails_as_a_value():
    flow = still_flow()
    result = _distance_only(replace(flow, latent=np.full_like(flow.latent, np.nan)))
    assert result.status == "failed"
    assert "not a number" in result.message


def test_start_at_the_goal_is_reached_at_once():
    flow = eddying_flow(1)
    here = place(flow, 0.0, 0.0, 50.0)
    result = plan(flow, here, here)
    assert result.status == "reached"
    assert result.closest_approach < 1.0


@pytest.mark.parametrize(
    ("goal", "words"),
    [
        (Place(160.0, -40.0, 100.0), "outside the forecast's region"),
        (Place(-27.5, 40.0, 100.0), "outside the forecast's region"),
        (Place(152.5, -40.0, 401.0), "deepest level, 400 m"),
        (Place(152.5, -40.0, -1.0), "surface"),
        (Place(152.2, -40.0, float("nan")), "finite"),
        (Place(152.3, -40.0, 240.0), "on land"),
    ],
)
def test_goals_that_cannot_be_asked_for(goal, words):
    flow = still_flow()
    wet = flow.grid.wet.copy()
    wet[3:, 4, 3] = False
    flow = replace(flow, grid=replace(flow.grid, wet=wet))
    with pytest.raises(PlanError, match=words) as raised:
        plan(flow, Place(152.5, -40.0, 0.0), goal)
    assert "goal at" in str(raised.value)
    with pytest.raises(PlanError, match="start at"):
        plan(flow, goal, Place(152.5, -40.0, 0.0))
    assert raised.value.exit_code == 3


def test_land_below_a_shallow_goal_does_not_matter():
    flow = still_flow()
    wet = flow.grid.wet.copy()
    wet[3:, 4, 3] = False
    flow = replace(flow, grid=replace(flow.grid, wet=wet))
    assert plan(flow, Place(152.5, -40.0, 0.0), Place(152.3, -40.0, 60.0)).status == "reached"


def test_the_same_call_gives_the_same_bits_and_survives_a_pickle():
    flow = eddying_flow(20)
    ask = (flow, place(flow, -1e4, -1e4), place(flow, 1e4, 5e3, 150.0))
    first, again = plan(*ask), plan(*ask)
    assert _same(first, again)
    assert _same(first, pickle.loads(pickle.dumps(plan))(*pickle.loads(pickle.dumps(ask))))
    assert _same(first, pickle.loads(pickle.dumps(first)))


def test_a_warm_start_needs_fewer_iterations():
    flow = eddying_flow(21)
    goal = place(flow, 1.5e4, 1e4, 250.0)
    cold = plan(flow, place(flow, -1.5e4, -1e4), goal)
    later = len(cold.track) // 4
    here = place(flow, *cold.track[later])
    changed = replace(flow, latent=1.05 * flow.latent)
    warm = plan(changed, here, goal, warm=cold, start_time_ns=int(cold.track_time[later] * 1e9))
    left = cold.duration - float(cold.track_time[later])
    (rest,) = _remaining(cold, int(cold.track_time[later] * 1e9), 0.25)
    assert rest.duration == pytest.approx(left, abs=1e-6)
    np.testing.assert_allclose(
        np.rad2deg([rest.heading - 0.25, rest.glide_angle]),
        [cold.heading_deg, cold.glide_angle_deg],
    )
    assert _remaining(cold, round(2e9 * cold.duration), 0.25)[0].duration == 1.0
    assert warm.status == "reached"
    assert int(warm.statistics["iterations"]) <= int(cold.statistics["iterations"])


def test_a_plan_flown_in_its_own_flow_comes_as_close_and_in_another_differs():
    flow = eddying_flow(22)
    result = plan(flow, place(flow, -1e4, -1e4), place(flow, 1e4, 5e3, 150.0))
    time, track, distance = fly(flow, result)
    assert distance == pytest.approx(result.closest_approach, abs=0.5)
    assert time[-1] == pytest.approx(1.5 * result.duration)
    assert track.shape == (time.size, 3)
    assert fly(eddying_flow(23), result)[2] > 250.0


def ridge(flow, shallowest):
    """A bottom at 1000 m with a ridge of a depth [m] between 4.5 and 5.5 km east of the centre, on points 500 m apart."""
    x, y = np.meshgrid(np.arange(-30e3, 30.1e3, 500.0), np.arange(-25e3, 25.1e3, 500.0))
    longitude, latitude = to_geographic(flow.grid.projection, x, y)
    return Bathymetry(
        longitude, latitude, np.where((x >= 4.4e3) & (x <= 5.6e3), shallowest, 1000.0)
    )


@pytest.mark.parametrize(("shallowest", "reached"), [(221.0, True), (170.0, False)])
def test_a_glide_ends_where_it_meets_the_bottom(shallowest, reached):
    """In still water the straight glide to 300 m at 10 km is at 165 m over the ridge's end, 201 m with the step before."""
    flow = still_flow()
    start, goal = place(flow, 0.0, 0.0), place(flow, 10e3, 0.0, 300.0)
    made = plan(flow, start, goal, settings=GlideSettings(bathymetry=ridge(flow, shallowest)))
    assert (made.status == "reached") == reached
    if reached:
        assert made.track == pytest.approx(plan(flow, start, goal).track, abs=1e-6)
        return
    assert "the path comes within the clearance of 20 m of the bottom there" in made.message
    over = (made.track[:, 0] > 4e3) & (made.track[:, 0] < 6e3)
    assert np.all(made.track[over, 2] <= shallowest - 20.0 + 1e-3)


def test_a_glide_s_start_and_goal_lie_above_the_bottom():
    flow = still_flow()
    bottom = ridge(flow, 100.0)
    with pytest.raises(
        PlanError, match="goal at 81 m is below the bottom less the clearance of 20 m; move it up"
    ):
        plan(
            flow,
            place(flow, 0.0, 0.0),
            place(flow, 5e3, 0.0, 81.0),
            settings=GlideSettings(bathymetry=bottom),
        )
    with pytest.raises(
        PlanError, match="start at 96 m is below the bottom less the clearance of 5 m"
    ):
        plan(
            flow,
            place(flow, 5e3, 0.0, 96.0),
            place(flow, 0.0, 0.0),
            settings=GlideSettings(bathymetry=bottom, clearance=5.0),
        )


def test_what_the_optimiser_makes_worse_than_its_seed_is_polished_instead(
    monkeypatch,
):
    def worse(task: GlideTask, guess: Glide) -> Candidate:
        return fly_candidate(task, guess._replace(heading=guess.heading + 0.3), 1)

    monkeypatch.setattr(solve, "optimise", worse)
    result = _distance_only(still_flow(), max_duration=3e4)
    assert result.closest_approach <= result.statistics["best_seed_distance"]
    assert result.closest_approach == pytest.approx(np.hypot(4e4, 300.0) - 0.3 * 3e4, abs=10.0)
    assert "polished by Nelder-Mead" in result.message
