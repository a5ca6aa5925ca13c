"""The geostrophic shear across a line of profiles, against its slow twin, made density fields and repeats of a real line."""

from dataclasses import replace
from itertools import pairwise

import gsw
import numpy as np
import pytest
import xarray as xr

from replay_kit.core.geodesy import to_geographic
from replay_kit.core.grid import Projection
from replay_kit.measurements.ctd.sections import GRAVITY, RHO0, Profile, section_of
from replay_kit.measurements.ctd.thermal_wind import (
    GeostrophicShear,
    _misfit,
    depth_weights,
    garrett_munk,
    geopotential_matrix,
    place_of,
    rossby_radius,
    shear_of,
    slope_weights,
)
from tests.places import DATA
from tests.reference import thermal_wind as twin

DAY_NS = 86_400 * 10**9
LATITUDE = 40.0
LEVELS = np.arange(0.0, 815.0, 10.0)


def water(depth, risen, longitude, latitude):
    """Return temperatures in water of one salinity whose conservative temperature is that of other depths, and the pressures."""
    pressure = gsw.p_from_z(-depth, latitude)
    absolute = gsw.SA_from_SP(35.0, pressure, longitude, latitude)
    return gsw.t_from_CT(absolute, 4.0 + 14.0 * np.exp(-risen / 300.0), pressure), pressure


def line(
    n: int = 12,
    length: float = 60e3,
    tilt: float = 1e-3,
    noise: float = 0.0,
    latitude: float = LATITUDE,
    slant: float = 0.0,
) -> list[Profile]:
    """Return casts whose isopycnals rise by a share of the way to the east."""
    rng, depth, made = np.random.default_rng(1), np.arange(0.0, 820.0, 5.0), []
    for k, along in enumerate(np.linspace(-0.5 * length, 0.5 * length, n)):
        way = along + slant * (depth - depth.mean())
        place = to_geographic(Projection(-60.0, latitude), way, 0.0 * way)
        heave = tilt * way + noise * rng.standard_normal() * np.sin(np.pi * depth / 800.0)
        temperature, _ = water(depth, depth + heave, *place)
        times = np.full(depth.size, k * DAY_NS // 12, dtype=np.int64)
        made.append(Profile(times, *place, depth, temperature, np.full(depth.size, 35.0)))
    return made


def expected(tilt: float) -> np.ndarray:
    """Return the shear of the made field on the levels, from its thermal wind by differences, minus its mean."""
    density = []
    for way in (-100.0, 100.0):
        temperature, pressure = water(LEVELS, LEVELS + tilt * way, -60.0, LATITUDE)
        absolute = gsw.SA_from_SP(35.0, pressure, -60.0, LATITUDE)
        density.append(gsw.rho_t_exact(absolute, temperature, pressure))
    # f dv/dz = -g / rho0 drho/dx, z upwards
    by_depth = GRAVITY / RHO0 * (density[1] - density[0]) / 200.0 / gsw.f(LATITUDE)
    layers = 0.5 * (by_depth[1:] + by_depth[:-1]) * np.diff(LEVELS)
    found = np.concatenate([[0.0], np.cumsum(layers)])
    return found - depth_weights(LEVELS) @ found


def shear_of_all(profiles: list[Profile]) -> GeostrophicShear:
    """Return the shear of all profiles of a line."""
    section = section_of(profiles)
    return shear_of(section, 0.1, np.arange(section.along.size))


def test_isopycnals_that_rise_to_the_east_give_their_thermal_wind():
    shear = shear_of_all(line(length=20e3))
    assert np.array_equal(shear.levels, LEVELS)
    # a mean over the line of the exponential's curvature, and the reference density, are left
    assert shear.velocity == pytest.approx(expected(1e-3), abs=0.01 * np.abs(expected(1e-3)).max())
    # dense water rises to the east: on the northern side the current above is to the south
    assert shear.velocity[0] < 0.0
    assert shear.direction == pytest.approx(0.5 * np.pi, abs=1e-6)
    assert depth_weights(LEVELS) @ shear.velocity == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    ("other", "sign"),
    [
        # whichever way the line is run; the same density in the south; the slant of a glider
        (line(length=20e3)[::-1], -1.0),
        (line(length=20e3, latitude=-40.0), -1.0),
        (line(length=20e3, slant=2.0), 1.0),
    ],
)
def test_the_current_is_that_of_the_field_and_not_of_the_line(other, sign):
    one, other = shear_of_all(line(length=20e3)), shear_of_all(other)
    turned = np.cos(one.direction - other.direction)
    limit = 0.02 * np.abs(one.velocity).max()
    assert other.velocity == pytest.approx(sign * one.velocity, abs=limit)
    assert abs(turned) == pytest.approx(1.0)


def test_a_short_line_states_a_large_error():
    errors = [
        shear_of_all(line(n, length, noise=7.0)).standard_error.max()
        for n, length in ((5, 8e3), (9, 20e3), (13, 40e3))
    ]
    assert errors[0] > 2.0 * errors[1] > 2.0 * errors[2]


@pytest.mark.parametrize(
    "profiles",
    [
        line()[:3],
        [*line(), *line()[:6]],
        line()[:1] * 5,
        [replace(each, salinity=np.full(164, np.nan)) for each in line()],
    ],
)
def test_what_is_no_line_is_refused(profiles):
    assert section_of(profiles) is None


def test_the_parts_agree_with_their_slow_twins():
    rng = np.random.default_rng(3)
    levels, n = np.sort(rng.uniform(0.0, 900.0, 9)), 8
    anomaly = rng.standard_normal((n, 9)) * 1e-7
    for row in anomaly:
        assert geopotential_matrix(levels) @ row == pytest.approx(
            twin.geopotential(row, levels), rel=1e-11
        )
    along = np.sort(rng.uniform(0.0, 50e3, n))
    root = rng.standard_normal((n, n))
    covariance = root @ root.T + n * np.eye(n)
    values = rng.standard_normal((n, 2))
    weights = slope_weights(along, covariance)
    assert weights @ values[:, 0] == pytest.approx(
        twin.slope(along, values[:, 0], covariance), rel=1e-9
    )
    # a straight line is seen as it is, wherever the weights lie
    assert weights @ along == pytest.approx(1.0)
    assert along[0] < place_of(along, weights) < along[-1]
    trend, prior = np.stack([np.ones(n), along - along.mean()], axis=1), np.array([0.5, 2.0])
    found, by_hand = [], []
    for each in (covariance, covariance + np.eye(n)):
        misfit, log_det = _misfit(each, trend, values)
        found.append(-0.5 * log_det - 0.5 * (2.2 + n - 2) * np.log(2.2 * prior + misfit))
        by_hand.append(
            [twin.log_evidence(each, trend, values[:, k], prior[k], 2.2) for k in range(2)]
        )
    np.testing.assert_allclose(np.diff(found, axis=0), np.diff(by_hand, axis=0), rtol=1e-6)


def test_waves_and_rossby_radius_have_the_size_that_the_open_ocean_has():
    n2 = np.full(LEVELS.size, 2.7e-5)
    waves = garrett_munk(LEVELS, n2, geopotential_matrix(LEVELS))
    assert np.linalg.eigvalsh(waves).min() > -1e-12 * np.trace(waves)
    # some millimetres of dynamic height
    assert 0.001 < np.sqrt(np.diag(waves)).mean() / GRAVITY < 0.01
    assert 20e3 < rossby_radius(LEVELS, n2, float(gsw.f(40.0))) < 60e3


@pytest.mark.full
def test_repeats_of_a_real_line_agree_within_their_stated_errors():
    files = sorted((DATA / "sections").glob("section*.nc"), key=lambda path: int(path.stem[7:]))
    if len(files) < 11:
        pytest.skip("the repeats of a line across a passage are not present")
    found = [shear_of_all(_casts(path)) for path in files]
    inside, misfits = [], []
    for a, b in pairwise(found):
        at = np.flatnonzero(np.isin(a.levels, [60, 150, 300, 500, 750, 900]))
        sign = np.sign(np.cos(a.direction - b.direction))
        difference = a.velocity[at] - sign * b.velocity[at]
        both = (a.covariance + b.covariance)[np.ix_(at, at)]
        inside += (np.abs(difference) < 1.645 * np.sqrt(np.diag(both))).tolist()
        misfits.append(difference @ np.linalg.solve(both, difference) / at.size)
    assert 0.85 <= np.mean(inside) <= 0.97
    assert 0.4 < np.mean(misfits) < 1.3


def _casts(path) -> list[Profile]:
    with xr.open_dataset(path) as data:
        names = ["lon", "lat", "salinity", "potential_temperature"]
        ordered = data.sortby("distance").transpose("date", "depth", ...)
        depth, times = ordered.depth.values, ordered.date.values.astype("datetime64[ns]")
        made = []
        for time, *cast in zip(times, *(ordered[name].values for name in names), strict=True):
            longitude, latitude, salinity, potential = cast
            pressure = gsw.p_from_z(-depth, latitude)
            absolute = gsw.SA_from_SP(salinity, pressure, longitude, latitude)
            temperature = gsw.t_from_CT(absolute, gsw.CT_from_pt(absolute, potential), pressure)
            own = (np.full(depth.size, one) for one in (time.astype(np.int64), longitude, latitude))
            made.append(Profile(*own, depth, temperature, salinity))
    return made
