import numpy as np
import pytest

from replay_kit.core.errors import ForecastError
from replay_kit.core.geodesy import distance, to_geographic, to_local
from replay_kit.studies.twins import glider
from replay_kit.studies.twins.adcp import measure
from replay_kit.studies.twins.field import build_field, grid_indices
from replay_kit.studies.twins.vehicle import EPOCH_NS, Mission, survey
from tests.studies.twins.truths import CENTRE, LEVELS, make_truth


def _no_flow(
    east: np.ndarray, north: np.ndarray, depth: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    still = np.zeros(np.broadcast_shapes(east.shape, depth.shape))
    return still, still


def _uniform(
    east: np.ndarray, north: np.ndarray, depth: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    still, _ = _no_flow(east, north, depth)
    return still + 0.06, still - 0.03


def _fly(flow: object, pings: int = 60, seed: int = 0) -> Mission:
    return glider.mission(
        build_field(make_truth(flow)), pings, EPOCH_NS, np.random.default_rng(seed)
    )  # type: ignore[arg-type]


def test_a_survey_covers_the_region_at_five_metres_a_second():
    truth = make_truth()
    made = survey(build_field(truth), 200, EPOCH_NS, np.random.default_rng(1))
    east, north = made.pings.east, made.pings.north
    steps = np.hypot(np.diff(east), np.diff(north))
    np.testing.assert_allclose(np.diff(made.pings.time_ns) * 1e-9 * 5.0, steps, atol=0.01)
    # nearest first: far shorter than a random order
    assert (
        steps.sum()
        < 0.25
        * np.hypot(
            *(np.diff(np.random.default_rng(0).permutation(part)) for part in (east, north))
        ).sum()
    )
    assert np.isfinite(build_field(truth).velocity(east, north, 0.0)).all()
    # each quarter of the grid has its share
    _, i, _ = grid_indices(build_field(truth), east, north)
    assert np.histogram(i, bins=4, range=(0, 20))[0].min() > 25
    assert made.dives == ()
    assert not any(position.dead_reckoned for position in made.positions)


def test_each_ping_has_a_logged_position_at_its_time():
    for made in (
        _fly(_uniform),
        survey(build_field(make_truth()), 30, EPOCH_NS, np.random.default_rng(1)),
    ):
        logged = {position.time_ns: position for position in made.positions}
        assert len(logged) == len(made.positions)
        for k, time_ns in enumerate(made.pings.time_ns.tolist()):
            assert logged[time_ns].depth == pytest.approx(made.pings.depth[k], abs=1e-3)
        times = [position.time_ns for position in made.positions]
        assert times == sorted(times)


def test_a_glider_pings_every_ten_minutes_on_a_sawtooth():
    made = _fly(_no_flow, 100)
    assert np.unique(np.diff(made.pings.time_ns)).tolist() == [600 * 10**9]
    depth, pitch = made.pings.depth, made.pings.pitch_deg
    assert 400.0 < depth.max() <= 500.0
    assert (np.sort(np.unique(pitch)) == [-20.0, 0.0, 20.0]).all() or set(np.unique(pitch)) == {
        -20.0,
        20.0,
    }
    rate = np.abs(np.diff(depth)) / 600.0
    assert np.median(rate) == pytest.approx(0.3 * np.sin(np.deg2rad(20.0)), rel=0.03)


def test_in_still_water_dead_reckoning_is_exact_and_the_mean_current_zero():
    made = _fly(_no_flow)
    for dive in made.dives:
        assert np.abs(dive.current).max() < 1e-12
    east, north = to_local(
        CENTRE, [p.longitude for p in made.positions], [p.latitude for p in made.positions]
    )
    time_s = np.array([p.time_ns for p in made.positions]) * 1e-9
    at = np.column_stack(
        [np.interp(made.pings.time_ns * 1e-9, time_s, part) for part in (east, north)]
    )
    np.testing.assert_allclose(at, np.column_stack([made.pings.east, made.pings.north]), atol=0.1)


def test_a_uniform_current_is_the_mean_current_of_each_dive():
    made = _fly(_uniform)
    assert len(made.dives) > 2
    for dive in made.dives:
        # true axes differ from the local ones by the meridian convergence, about a degree at the edge
        np.testing.assert_allclose(dive.current, (0.06, -0.03), atol=1.5e-3)
        assert not dive.start.dead_reckoned
        assert not dive.end.dead_reckoned
        assert dive.end.time_ns > dive.start.time_ns


def test_dead_reckoning_errs_by_less_than_a_cell_in_shear():
    made = glider.mission(build_field(make_truth()), 100, EPOCH_NS, np.random.default_rng(0))
    logged = {position.time_ns: position for position in made.positions}
    longitude, latitude = to_geographic(CENTRE, made.pings.east, made.pings.north)
    at = [logged[t] for t in made.pings.time_ns.tolist()]
    error = distance(longitude, latitude, [p.longitude for p in at], [p.latitude for p in at])
    assert 0.0 < error.max() < 3000.0


def test_a_dive_goes_no_deeper_than_the_truth():
    made = glider.mission(
        build_field(make_truth(levels=LEVELS[:3])), 40, EPOCH_NS, np.random.default_rng(0)
    )
    assert 100.0 < made.pings.depth.max() <= 150.0


@pytest.mark.full
def test_a_long_mission_turns_and_stays_inside():
    made = _fly(_uniform, 700)
    assert np.isfinite(
        build_field(make_truth(_uniform)).velocity(
            made.pings.east, made.pings.north, made.pings.depth
        )
    ).all()
    assert np.unique(np.round(made.pings.heading_deg, -1)).size > 3


def test_a_glider_swept_out_of_the_truth_says_where():
    def torrent(
        east: np.ndarray, north: np.ndarray, depth: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        still, _ = _no_flow(east, north, depth)
        return still + 2.0, still

    with pytest.raises(ForecastError, match=r"carried the glider out .* E, .* N"):
        _fly(torrent)


def test_bins_measure_the_truth_in_true_axes():
    truth = make_truth(_uniform)
    field = build_field(truth)
    made = survey(field, 20, EPOCH_NS, np.random.default_rng(1))
    velocity = measure(field, made.pings, 0.0, np.random.default_rng(0))
    assert velocity.shape == (20, 22, 2)
    assert np.isfinite(velocity).all()
    np.testing.assert_allclose(np.hypot(*velocity.T), np.hypot(0.06, 0.03), atol=1e-9)
    # South of the equator and east of the centre true north leans to the east of the local north, by the difference in
    # longitude times sin(latitude), so that a vector seen from true axes is turned anticlockwise.
    longitude, latitude = to_geographic(CENTRE, made.pings.east, made.pings.north)
    turn = np.arctan2(velocity[:, 0, 1], velocity[:, 0, 0]) - np.arctan2(-0.03, 0.06)
    np.testing.assert_allclose(
        turn, -np.deg2rad((longitude - CENTRE.longitude) * np.sin(np.deg2rad(latitude))), atol=3e-4
    )


def test_bins_below_the_last_level_are_nan():
    field = build_field(make_truth(levels=LEVELS[:4]))
    made = survey(field, 3, EPOCH_NS, np.random.default_rng(1))
    velocity = measure(field, made.pings, 0.09, np.random.default_rng(0))
    below = 16.0 + 32.0 * np.arange(22) > 300.0
    assert (np.isnan(velocity).all(axis=(0, 2)) == below).all()


def test_noise_has_the_stated_size():
    field = build_field(make_truth(_no_flow))
    made = survey(field, 300, EPOCH_NS, np.random.default_rng(1))
    velocity = measure(field, made.pings, 0.09, np.random.default_rng(0))
    assert velocity.std() == pytest.approx(0.09, rel=0.02)
