import numpy as np
import pytest

from replay_kit.core.errors import ForecastError
from replay_kit.core.geodesy import to_geographic, to_local
from replay_kit.studies.twins import glider
from replay_kit.studies.twins.adcp import measure
from replay_kit.studies.twins.field import build_field, grid_indices
from replay_kit.studies.twins.vehicle import EPOCH_NS, Mission, survey
from tests.studies.twins.truths import CENTRE, LEVELS, make_truth


def _uniform(east=0.06, north=-0.03):
    """A current that is the same everywhere."""

    def flow(x, y, depth):
        still = np.zeros(np.broadcast_shapes(x.shape, depth.shape))
        return still + east, still + north

    return flow


STILL = _uniform(0.0, 0.0)


def _fly(pings=60, **truth) -> Mission:
    field = build_field(make_truth(**truth))
    return glider.mission(field, pings, EPOCH_NS, np.random.default_rng(0))


def _survey(pings, **truth):
    field = build_field(make_truth(**truth))
    return field, survey(field, pings, EPOCH_NS, np.random.default_rng(1))


def test_a_survey_covers_the_region_at_five_metres_a_second():
    field, made = _survey(200)
    east, north = made.pings.east, made.pings.north
    steps = np.hypot(np.diff(east), np.diff(north))
    np.testing.assert_allclose(np.diff(made.pings.time_ns) * 1e-9 * 5.0, steps, atol=0.01)
    # nearest first: far shorter than a random order
    order = np.random.default_rng(0).permutation(200)
    assert steps.sum() < 0.25 * np.hypot(np.diff(east[order]), np.diff(north[order])).sum()
    assert np.isfinite(field.velocity(east, north, 0.0)).all()
    # each quarter of the grid has its share
    _, i, _ = grid_indices(field, east, north)
    assert np.histogram(i, bins=4, range=(0, 20))[0].min() > 25
    assert made.dives == ()
    assert not any(position.dead_reckoned for position in made.positions)


def test_each_ping_has_a_logged_position_at_its_time():
    for made in (_fly(flow=_uniform()), _survey(30)[1]):
        logged = {position.time_ns: position for position in made.positions}
        assert len(logged) == len(made.positions)
        assert [position.time_ns for position in made.positions] == sorted(logged)
        depths = [logged[time_ns].depth for time_ns in made.pings.time_ns.tolist()]
        np.testing.assert_allclose(depths, made.pings.depth, atol=1e-3)


def test_a_glider_pings_every_ten_minutes_on_a_sawtooth_no_deeper_than_the_truth():
    made = _fly(100, flow=STILL)
    assert np.unique(np.diff(made.pings.time_ns)).tolist() == [600 * 10**9]
    depth, pitch = made.pings.depth, made.pings.pitch_deg
    assert 400.0 < depth.max() <= 500.0
    assert set(pitch) - {0.0} == {-20.0, 20.0}
    rate = np.abs(np.diff(depth)) / 600.0
    assert np.median(rate) == pytest.approx(0.3 * np.sin(np.deg2rad(20.0)), rel=0.03)
    assert 100.0 < _fly(40, levels=LEVELS[:3]).pings.depth.max() <= 150.0


def test_in_still_water_dead_reckoning_is_exact_and_a_uniform_current_is_each_dive_s_mean():
    made = _fly(flow=STILL)
    assert max(np.abs(dive.current).max() for dive in made.dives) < 1e-12
    longitude, latitude, time_ns = np.array(
        [(one.longitude, one.latitude, one.time_ns) for one in made.positions]
    ).T
    for part, flown in zip(
        to_local(CENTRE, longitude, latitude), (made.pings.east, made.pings.north), strict=True
    ):
        np.testing.assert_allclose(np.interp(made.pings.time_ns, time_ns, part), flown, atol=0.1)
    made = _fly(flow=_uniform())
    assert len(made.dives) > 2
    for dive in made.dives:
        # true axes differ from the local ones by the meridian convergence, about a degree at the edge
        np.testing.assert_allclose(dive.current, (0.06, -0.03), atol=1.5e-3)
        assert not dive.start.dead_reckoned
        assert not dive.end.dead_reckoned
        assert dive.end.time_ns > dive.start.time_ns


@pytest.mark.full
def test_a_long_mission_turns_and_stays_inside():
    pings = _fly(700, flow=_uniform()).pings
    inside = build_field(make_truth(_uniform())).velocity(pings.east, pings.north, pings.depth)
    assert np.isfinite(inside).all()
    assert np.unique(np.round(pings.heading_deg, -1)).size > 3


def test_a_glider_swept_out_of_the_truth_says_where():
    with pytest.raises(ForecastError, match=r"carried the glider out .* E, .* N"):
        _fly(flow=_uniform(2.0, 0.0))


def test_bins_measure_the_truth_in_true_axes_to_the_last_level():
    field, made = _survey(20, flow=_uniform(), levels=LEVELS[:4])
    velocity = measure(field, made.pings, 0.0, np.random.default_rng(0))
    below = 16.0 + 32.0 * np.arange(22) > 300.0
    assert velocity.shape == (20, 22, 2)
    assert (np.isnan(velocity) == below[:, None]).all()
    np.testing.assert_allclose(np.hypot(*velocity[:, ~below].T), np.hypot(0.06, 0.03), atol=1e-9)
    # South of the equator and east of the centre true north leans to the east of the local north, by the difference in
    # longitude times sin(latitude), so that a vector seen from true axes is turned anticlockwise.
    longitude, latitude = to_geographic(CENTRE, made.pings.east, made.pings.north)
    turn = np.arctan2(velocity[:, 0, 1], velocity[:, 0, 0]) - np.arctan2(-0.03, 0.06)
    lean = np.deg2rad((longitude - CENTRE.longitude) * np.sin(np.deg2rad(latitude)))
    np.testing.assert_allclose(turn, -lean, atol=3e-4)


def test_noise_has_the_stated_size():
    field, made = _survey(300, flow=STILL)
    velocity = measure(field, made.pings, 0.09, np.random.default_rng(0))
    assert velocity.std() == pytest.approx(0.09, rel=0.02)
