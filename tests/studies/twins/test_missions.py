import numpy as np
import pytest

from replay_kit.core.errors import ForecastError
from replay_kit.core.geodesy import to_geographic, to_local
from replay_kit.studies.twins.field import build_field, grid_indices
from replay_kit.studies.twins.make import measure
from replay_kit.studies.twins.mission import Mission, dives, survey
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
    return dives(field, pings, np.random.default_rng(0))


def _survey(pings, **truth):
    field = build_field(make_truth(**truth))
    return field, survey(field, pings, np.random.default_rng(1))


def test_a_survey_covers_the_region_at_five_metres_a_second():
    field, made = _survey(200)
    east, north, _ = made.place.T
    steps = np.hypot(np.diff(east), np.diff(north))
    np.testing.assert_allclose(np.diff(made.time_ns) * 1e-9 * 5.0, steps, atol=0.01)
    # nearest first: far shorter than a random order
    order = np.random.default_rng(0).permutation(200)
    assert steps.sum() < 0.25 * np.hypot(np.diff(east[order]), np.diff(north[order])).sum()
    assert np.isfinite(field.velocity(east, north, 0.0)).all()
    # each quarter of the grid has its share
    _, i, _ = grid_indices(field, east, north)
    assert np.histogram(i, bins=4, range=(0, 20))[0].min() > 25
    assert made.pinged.all()
    assert len(made.dives) == 0
    assert not made.dead_reckoned.any()


def test_each_ping_has_a_logged_position_at_its_time():
    for made in (_fly(flow=_uniform()), _survey(30)[1]):
        assert (np.diff(made.time_ns) > 0).all()
        np.testing.assert_allclose(made.logged[:, 2], made.place[:, 2], atol=1e-3)
        assert not made.dead_reckoned[made.place[:, 2] == 0.0].any()


def test_a_glider_pings_every_ten_minutes_on_a_sawtooth_no_deeper_than_the_truth():
    made = _fly(100, flow=STILL)
    assert np.unique(np.diff(made.time_ns[made.pinged])).tolist() == [600 * 10**9]
    depth, pitch = made.place[made.pinged, 2], made.pitch_deg[made.pinged]
    assert 400.0 < depth.max() <= 500.0
    assert set(pitch) - {0.0} == {-20.0, 20.0}
    rate = np.abs(np.diff(depth)) / 600.0
    assert np.median(rate) == pytest.approx(0.3 * np.sin(np.deg2rad(20.0)), rel=0.03)
    assert 100.0 < _fly(40, levels=LEVELS[:3]).place[:, 2].max() <= 150.0


def test_in_still_water_dead_reckoning_is_exact_and_a_uniform_current_is_each_dive_s_mean():
    made = _fly(flow=STILL)
    assert np.abs(made.current).max() < 1e-12
    stated = np.column_stack(to_local(CENTRE, *made.logged[:, :2].T))
    np.testing.assert_allclose(stated, made.place[:, :2], atol=0.1)
    made = _fly(flow=_uniform())
    assert len(made.dives) > 2
    # true axes differ from the local ones by the meridian convergence, about a degree at the edge
    np.testing.assert_allclose(
        made.current, np.tile((0.06, -0.03), (len(made.dives), 1)), atol=1.5e-3
    )
    assert not made.dead_reckoned[made.dives].any()
    assert (np.diff(made.time_ns[made.dives]) > 0).all()


@pytest.mark.full
def test_a_long_mission_turns_and_stays_inside():
    made = _fly(700, flow=_uniform())
    inside = build_field(make_truth(_uniform())).velocity(*made.place.T)
    assert np.isfinite(inside).all()
    assert np.unique(np.round(made.heading_deg, -1)).size > 3


def test_a_glider_swept_out_of_the_truth_says_where():
    with pytest.raises(ForecastError, match=r"carried the glider out .* E, .* N"):
        _fly(flow=_uniform(2.0, 0.0))


def test_bins_measure_the_truth_in_true_axes_to_the_last_level():
    field, made = _survey(20, flow=_uniform(), levels=LEVELS[:4])
    velocity = measure(field, made.place, 0.0, np.random.default_rng(0))
    below = 16.0 + 32.0 * np.arange(22) > 300.0
    assert velocity.shape == (20, 22, 2)
    assert (np.isnan(velocity) == below[:, None]).all()
    np.testing.assert_allclose(np.hypot(*velocity[:, ~below].T), np.hypot(0.06, 0.03), atol=1e-9)
    # South of the equator and east of the centre true north leans to the east of the local north, by the difference in
    # longitude times sin(latitude), so that a vector seen from true axes is turned anticlockwise.
    longitude, latitude = to_geographic(CENTRE, *made.place[:, :2].T)
    turn = np.arctan2(velocity[:, 0, 1], velocity[:, 0, 0]) - np.arctan2(-0.03, 0.06)
    lean = np.deg2rad((longitude - CENTRE.longitude) * np.sin(np.deg2rad(latitude)))
    np.testing.assert_allclose(turn, -lean, atol=3e-4)


def test_noise_has_the_stated_size():
    field, made = _survey(300, flow=STILL)
    velocity = measure(field, made.place, 0.09, np.random.default_rng(0))
    assert velocity.std() == pytest.approx(0.09, rel=0.02)
