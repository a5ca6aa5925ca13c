"""What must not change when the world is turned: no number of ours is compared, only two answers of the same program."""

import functools

import numpy as np
import pytest

import replay_kit as rk
from tests.properties import world
from tests.properties.world import (
    GOAL,
    HERE,
    MIRROR,
    QUARTER,
    START,
    STATED,
    answer,
    mission,
    replace,
    replayed,
    sea,
    tables,
)

SOUTH_FOR_NORTH = (HERE[0], -HERE[1])


@functools.cache
def plain(settings="stated", factor=1.0):
    return replayed(sea().times(factor), settings=STATED if settings == "stated" else None)


@pytest.mark.parametrize("settings", ["stated", "fitted"])
def test_the_sea_is_turned_by_a_right_angle(settings):
    given = STATED if settings == "stated" else None
    turned = replayed(sea().moved_by(QUARTER), settings=given)
    answer(turned, matrix=QUARTER).is_like(answer(plain(settings)), 5e-3)


@pytest.mark.parametrize("settings", ["stated", "fitted"])
def test_the_sea_is_mirrored_at_the_equator(settings):
    given = STATED if settings == "stated" else None
    mirrored = replayed(sea().moved_by(MIRROR), SOUTH_FOR_NORTH, given)
    answer(mirrored, SOUTH_FOR_NORTH, MIRROR).is_like(answer(plain(settings)), 1e-6)


@pytest.mark.parametrize("settings", ["stated", "fitted"])
def test_members_come_in_another_order(settings):
    s, order = sea(), np.random.default_rng(3).permutation(12)
    given = STATED if settings == "stated" else None
    permuted = replayed(replace(s, members=s.members[order]), settings=given)
    answer(permuted).is_like(answer(plain(settings)), 1e-6)


@pytest.mark.parametrize("longitude", [180.0, 0.0, -180.0, 1e-9 - 180.0])
def test_the_sea_is_moved_along_the_parallel(longitude):
    there = (longitude, HERE[1])
    answer(replayed(sea(), there), there).is_like(answer(plain()), 5e-3)


@pytest.mark.parametrize("written", [0.0, 360.0])
@pytest.mark.parametrize("asked", [0.0, 360.0, 720.0, -3600.0])
def test_longitudes_count_turns_as_they_like(written, asked):
    west = (-30.0, HERE[1])
    got = answer(turns(written), west, east=asked)
    got.is_like(answer(turns(0.0), west), 1e-3)


@functools.cache
def turns(east):
    return replayed(sea(), (-30.0, HERE[1]), east=east)


@pytest.mark.parametrize("factor", [2.0, 0.5, -1.0])
def test_all_speeds_are_scaled(factor):
    answer(plain(factor=factor), factor=factor).is_like(answer(plain()), 5e-3)


def test_the_forecast_is_in_another_unit_of_another_year():
    answer(replayed(sea(), per_metre=100.0, date="2021-02-27")).is_like(answer(plain()), 1e-3)


def test_a_log_of_three_files_may_be_given_in_any_order(tmp_path):
    table, forecast = tables(sea())
    forecast.to_netcdf(tmp_path / "e.nc")
    parts = []
    for part, times in enumerate(np.array_split(np.sort(table.time.unique()), 3)):
        out = tmp_path / f"{part}.mcap"
        rk.replay(table[table.time.isin(times)], forecast, settings=STATED, out=out)
        parts.append(out.with_suffix(".observations.mcap"))
    one, other = (
        rk.replay(order, tmp_path / "e.nc", settings=STATED).estimate.latent
        for order in (parts, parts[::-1])
    )
    np.testing.assert_array_equal(one, other)
    np.testing.assert_allclose(one, plain().latent, atol=1e-6 * np.abs(one).max())


@pytest.mark.parametrize("longitude", [5.0, 180.0])
def test_pings_close_together_are_grouped_alike_on_every_course(longitude):
    """To the east and to the north at 70 degrees, where a degree of longitude is a third of one of latitude."""
    there, s = (longitude, 70.0), sea(1, profiles=240, seconds=5.0, half=1.5e3, bend=False)
    north = answer(replayed(s.moved_by(QUARTER), there), there, QUARTER)
    north.is_like(answer(replayed(s, there), there), 5e-3)


@pytest.mark.parametrize("rough", [2e-3, 0.0])
# which directions are small enough to be dropped depends on rounding, so few are
@pytest.mark.parametrize(
    "settings", [STATED, {"estimator": {"dropped_std": 1e-3}}], ids=["stated", "fitted"]
)
def test_rounding_of_the_forecast_hardly_counts(rough, settings):
    """1e-5 m/s: a hundredth of what packing in 16 bits leaves."""
    s, rng = sea(rough=rough), np.random.default_rng(9)
    noisy = replace(s, members=s.members + 1e-5 * rng.standard_normal(s.members.shape))
    one, other = (answer(replayed(each, settings=settings)) for each in (noisy, s))
    one.is_like(other, 1e-2)


def test_there_in_a_current_is_back_in_the_reversed_one():
    there, back = mission(plain()), mission(plain(factor=-1.0), GOAL, START)
    assert there.status == back.status == "reached"
    assert back.duration == pytest.approx(there.duration, rel=0.02)


def test_a_turned_mission_takes_as_long_on_turned_headings():
    flow = replayed(sea().moved_by(QUARTER))
    plan, turned = mission(plain()), mission(flow, *(QUARTER @ at for at in (START, GOAL)))
    assert turned.duration == pytest.approx(plan.duration, rel=0.02)
    ways = [np.exp(1j * np.deg2rad(each.headings_deg)).mean() for each in (plan, turned)]
    assert np.angle(ways[0] / ways[1], deg=True) == pytest.approx(90.0, abs=3.0)


def test_time_at_the_surface_makes_no_mission_shorter():
    assert mission(plain(), surface_time=1200.0).duration >= 0.995 * mission(plain()).duration


def test_the_world_is_what_it_says():
    """Turned four times or mirrored twice it is itself; its members do not diverge."""
    s = sea(rough=0.0)
    np.testing.assert_allclose(
        functools.reduce(lambda each, _: each.moved_by(QUARTER), range(4), s).members, s.members
    )
    np.testing.assert_allclose(s.moved_by(MIRROR).moved_by(MIRROR).profiles, s.profiles)
    u, v = np.moveaxis(s.members, -1, 0)
    divergence = np.gradient(u, axis=3) + np.gradient(v, axis=2)
    assert np.abs(divergence[..., 1:-1, 1:-1]).max() < 0.2 * np.abs(np.gradient(u, axis=2)).max()
    assert world.LEVELS.size == s.members.shape[1]
