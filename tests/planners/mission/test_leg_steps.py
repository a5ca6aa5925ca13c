"""A leg's steps: how many, where they end, what their integrators are exact for, and the current at each stage."""

from dataclasses import replace

import numpy as np
import pytest

from planners import Glider
from planners.mission.flight.currents import currents_of, currents_of_samples
from planners.mission.flight.legs import Legs, fly_legs, fly_midpoints, fly_steps
from planners.mission.task import leg_depths, refine_steps, step_stops, steps_needed
from planners.shooting.schedule import DRIFT_STEPS
from replay_kit.core.flow.depth import depth_weights
from tests.planners.flow_samples import LEVELS, eddying_flow
from tests.reference.leg import leg_function, stage_latent

GLIDER, HERE = Glider(), np.array([3e3, -4e3])
DAY_NS = 86_400 * 10**9


def test_a_leg_needs_a_step_for_each_dive_climb_and_level_crossed() -> None:
    levels = np.array(LEVELS)
    # down and up again through 5, 40, 110 and 230 m; to 110 m only 5 and 40 m are crossed
    assert steps_needed((0.0, 300.0, 0.0), levels, 1) == 8 + 2
    assert steps_needed((0.0, 300.0, 0.0), levels, 3) == 8 + 6
    assert steps_needed((0.0, 110.0, 0.0), levels, 2) == 4 + 4
    assert steps_needed((110.0, 230.0), levels, 2) == 2


def test_steps_go_where_the_way_to_each_is_longest() -> None:
    none = np.array([1e4])
    np.testing.assert_allclose(leg_depths((50.0, 100.0, 0.0), none, 3), [50.0, 100.0, 50.0, 0.0])
    np.testing.assert_allclose(
        leg_depths((0.0, 60.0, 0.0), none, 5), [0.0, 20.0, 40.0, 60.0, 30.0, 0.0]
    )
    # a level within the dive has a step's end of its own there, and no more are needed
    np.testing.assert_allclose(
        leg_depths((0.0, 60.0, 0.0), np.array([20.0]), 4), [0.0, 20.0, 60.0, 20.0, 0.0]
    )


def test_steps_also_end_at_goals_below_the_surface() -> None:
    np.testing.assert_array_equal(
        step_stops(np.array([5.0, 40.0]), np.array([0.0, 30.0, 40.0])), [5.0, 30.0, 40.0]
    )


def test_a_step_cut_in_parts_goes_evenly_through_its_depths() -> None:
    np.testing.assert_allclose(
        refine_steps(np.array([0.0, 10.0, 40.0]), 2), [0.0, 5.0, 10.0, 25.0, 40.0]
    )
    np.testing.assert_array_equal(refine_steps(np.array([0.0, 10.0]), 1), [0.0, 10.0])


@pytest.mark.parametrize(("method", "power"), [(fly_steps, 3), (fly_midpoints, 1)])
def test_a_rate_that_is_a_power_of_time_or_depth_is_integrated_exactly(method, power) -> None:
    depths, durations = np.array([0.0, 6.0, 2.0]), np.array([3.0, 2.0])

    def rate(_: float, depth: float, now: float) -> np.ndarray:
        return np.array([now**power, depth**power])

    path = method(rate, np.array([7.0, 0.0]), 1.0, depths, durations, 2)
    assert [now for _, now in path] == [4.0, 6.0]

    # the depth grows by 2 m/s for three seconds, then falls by 2 m/s for two
    def integral(begin: float, end: float) -> float:
        return (end ** (power + 1) - begin ** (power + 1)) / (power + 1)

    np.testing.assert_allclose(
        path[0][0], [7.0 + integral(1.0, 4.0), integral(0.0, 6.0) / 2.0], rtol=1e-12
    )
    np.testing.assert_allclose(
        path[1][0],
        [7.0 + integral(1.0, 6.0), (integral(0.0, 6.0) + integral(2.0, 6.0)) / 2.0],
        rtol=1e-12,
    )


@pytest.mark.parametrize("kind", ["hat", "gaussian"])
def test_each_stage_has_the_latent_velocities_of_its_depth_and_the_last_those_of_the_surface(
    kind: str,
) -> None:
    flow, later = (eddying_flow(seed, "hat" if kind == "hat" else "gaussian") for seed in (3, 4))
    depths = np.array([0.0, 60.0, 300.0, 20.0])
    both = np.concatenate([flow.latent, later.latent], axis=1)
    stages = stage_latent(both, flow.levels, flow.depth_functions, depths)
    expected = []
    for stage in (0.0, 30.0, 60.0, 180.0, 300.0, 160.0, 20.0, 0.0):
        at = depth_weights(flow.depth_functions, np.array([stage]), flow.levels)[0]
        expected += [flow.latent @ at, later.latent @ at]
    np.testing.assert_allclose(stages, np.column_stack(expected), atol=1e-15)


def _dated(seed: int, days: float):
    return replace(eddying_flow(seed), time_ns=10**18 + int(days * DAY_NS))


def test_a_flow_that_changes_is_between_its_times_by_their_share_and_before_and_after_them_as_they_are() -> (
    None
):
    first, second, third = flows = [
        _dated(seed, days) for seed, days in ((3, 0.0), (4, 1.0), (5, 3.0))
    ]
    currents = currents_of(flows)
    places, of_levels = np.array([[1e3, 2e3], [-8e3, 5e3]]), currents.weights(np.array([75.0]))[0]

    def of(flow) -> np.ndarray:
        return np.array([flow.velocity(*at, 75.0) for at in places])

    for days, expected in (
        *((-5.0, of(first)), (0.0, of(first)), (0.25, 0.75 * of(first) + 0.25 * of(second))),
        *((1.0, of(second)), (2.5, 0.25 * of(second) + 0.75 * of(third)), (9.0, of(third))),
    ):
        np.testing.assert_allclose(
            currents.velocity(places, of_levels, 86_400.0 * days), expected, atol=1e-12
        )


def test_a_flight_begins_at_its_time_on_the_clock_of_the_flow_and_knows_the_leg_of_each_point() -> (
    None
):
    changing = currents_of([_dated(3, 0.0), _dated(4, 0.5)])
    dive = leg_depths((0.0, 300.0, 0.0), np.array(LEVELS), 10)
    legs = Legs(np.array([0.3, 2.0]), np.array([0.3, 0.5]), (dive, dive), np.array([900.0, 0.0]))
    begin = 20_000.0
    flight = fly_legs(changing, GLIDER, HERE, legs, begin)
    # the second leg alone, from where and when the first and its drift have ended
    after = flight.ends[0]
    alone = Legs(legs.headings[1:], legs.angles[1:], legs.depths[1:], legs.drifts[1:])
    second = fly_legs(
        changing, GLIDER, flight.place[0, after], alone, begin + float(flight.time[after])
    )
    np.testing.assert_allclose(flight.place[0, after:], second.place[0], rtol=1e-12)
    np.testing.assert_allclose(
        flight.time[after:] - flight.time[after], second.time, rtol=1e-12, atol=1e-9
    )
    assert (
        np.linalg.norm(
            second.place[0, -1]
            - fly_legs(changing, GLIDER, flight.place[0, after], alone).place[0, -1]
        )
        > 10.0
    )
    assert flight.ends.tolist() == [10 + DRIFT_STEPS, 20 + DRIFT_STEPS]
    assert flight.leg.tolist() == [0] * (11 + DRIFT_STEPS) + [1] * 10
    np.testing.assert_array_equal(flight.depth, [*dive, *[0.0] * DRIFT_STEPS, *dive[1:]])


def test_the_optimiser_s_leg_begins_at_its_time_too() -> None:
    flows = [_dated(3, 0.0), _dated(4, 0.5)]
    currents = currents_of(flows)
    dive = leg_depths((0.0, 300.0, 0.0), np.array(LEVELS), 20)
    latent = stage_latent(currents.latent[0], flows[0].levels, flows[0].depth_functions, dive)
    leg = leg_function(flows[0], GLIDER, 20, currents.times, True)
    for begin in (0.0, 20_000.0):
        places, end = leg(HERE, begin, 1.0, 0.3, dive, 900.0, latent)
        flight = fly_legs(
            currents,
            GLIDER,
            HERE,
            Legs(np.array([1.0]), np.array([0.3]), (dive,), np.array([900.0])),
            begin,
        )
        np.testing.assert_allclose(np.asarray(places)[:, -1], flight.place[0, -1], atol=1.0)
        # the drift is the last place but one to the last
        np.testing.assert_allclose(np.asarray(places)[:, -2], flight.place[0, 20], atol=1.0)
        assert float(end) - begin == pytest.approx(flight.time[-1], rel=1e-12)


def test_one_current_serves_many_places_and_many_currents_each_its_own() -> None:
    flows = [eddying_flow(seed) for seed in (4, 5)]
    places = np.array([[1e3, 2e3], [-8e3, 5e3]])
    one, both = currents_of(flows[0]), currents_of_samples(flows)
    of_levels = one.weights(np.array([20.0]))[0]
    np.testing.assert_allclose(
        one.velocity(places, of_levels, 0.0),
        [flows[0].velocity(*at, 20.0) for at in places],
        atol=1e-12,
    )
    own = [flow.velocity(*at, 20.0) for flow, at in zip(flows, places, strict=True)]
    np.testing.assert_allclose(both.velocity(places, of_levels, 0.0), own, atol=1e-12)
