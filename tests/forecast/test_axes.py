"""Whether velocities lie along the axes that a file says."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal

from replay_kit.config.run import EstimatorConfig, ForecastConfig
from replay_kit.core.geodesy import to_local
from replay_kit.core.grid import Projection
from replay_kit.estimator.basis.modes import build_basis
from replay_kit.forecast import describe_ensemble
from replay_kit.forecast.grids.axes import geostrophic_flow
from tests.forecast import forms
from tests.forecast.forms import noted, read_with, save
from tests.places import DATA, needs

SHAPE, AS_TRUE = (20, 22), {"axes": "true"}


def flow(angle_deg, standard_names, sea_level=False):
    """A geostrophic current of eddies along the axes of a turned grid, labelled as asked, and perhaps its sea level."""
    j, i = np.mgrid[: float(SHAPE[0]), : float(SHAPE[1])]
    longitude, latitude = forms.rotated(angle_deg, shape=SHAPE, cell=0.04)(j, i)
    places = east, north = to_local(Projection(5.0, 60.0), longitude, latitude)
    heights = [0.1 * np.sin(east / (9e3 + 1e3 * k)) * np.cos(north / 1.1e4 + k) for k in (0, 1)]
    currents = np.array([geostrophic_flow(height, places, latitude) for height in heights])
    turned = currents * np.exp(-1j * np.deg2rad(angle_deg))
    dims, space = ("member", "y", "x"), ("y", "x")
    held = {
        name: (dims, part, {"standard_name": standard, "units": "m s-1"})
        for name, part, standard in zip(
            ("uo", "vo"), (turned.real, turned.imag), standard_names, strict=True
        )
    }
    held |= {"zos": (dims, np.stack(heights), {"units": "m"})} if sea_level else {}
    return xr.Dataset(held, {"longitude": (space, longitude), "latitude": (space, latitude)})


TRUE = ("eastward_sea_water_velocity", "northward_sea_water_velocity")
GRID = ("sea_water_x_velocity", "sea_water_y_velocity")


@pytest.mark.parametrize("sea_level", [False, True])
@pytest.mark.parametrize(("names", "right"), [(TRUE, False), (GRID, True)])
def test_a_wrong_label_is_told_with_the_option_that_mends_it(tmp_path, names, right, sea_level):
    path = save(flow(44.0, names, sea_level), tmp_path / "e.nc")
    found = describe_ensemble(path, ForecastConfig())
    read, check = found.ensemble, found.check
    assert check.angle == pytest.approx(44.0, abs=0.5)
    as_read, turned = check.residual
    assert (as_read < 0.01 < 0.1 < turned) if right else (turned < 0.01 < 0.1 < as_read)
    assert check.contradicted is not right
    assert noted(read, "WARNING: the velocities are used as read") is not right
    if not right:
        assert noted(read, "--axes grid turns them, --axes true keeps this reading")
        expected = np.sqrt(as_read * np.mean(read.velocity**2))
        assert read.representation_error_std == pytest.approx(expected, rel=0.05)
        # which the estimator takes as such
        both = read, replace(read, representation_error_std=0.0)
        told, trusted = (build_basis([each], EstimatorConfig(modes=1)) for each in both)
        expected = np.hypot(trusted.representation, read.representation_error_std)
        assert_allclose(told.representation, expected, rtol=1e-12)
        kept = describe_ensemble(path, ForecastConfig(axes="true"))
        assert kept.check.contradicted
        assert (kept.ensemble.notes, kept.ensemble.representation_error_std) == ((), 0.0)
    if sea_level:
        # read along true axes, the current lies 44 degrees to the right of the geostrophic one
        assert check.phase == pytest.approx((0.0, -44.0) if right else (-44.0, 0.0), abs=1.0)
    mended = describe_ensemble(path, ForecastConfig(axes="grid"))
    assert (mended.check.contradicted, mended.ensemble.representation_error_std) == (False, 0.0)
    labelled = read_with(save(flow(44.0, GRID), tmp_path / "g.nc"))
    assert_array_equal(mended.ensemble.velocity, labelled.velocity)


def test_below_a_degree_nothing_is_asked(tmp_path):
    check = describe_ensemble(
        save(flow(0.3, TRUE, True), tmp_path / "e.nc"), ForecastConfig()
    ).check
    assert 0.2 < check.angle < 1.0
    assert (check.residual, check.phase) == (None, None)


def test_geostrophic_flow_goes_round_a_high_clockwise_in_the_north():
    places = east, north = np.meshgrid(np.arange(5.0) * 1e4, np.arange(4.0) * 1e4)
    latitude, speed = np.full(east.shape, 45.0), 9.81e-5 / (2 * 7.2921e-5 * np.sin(np.pi / 4))
    for height, expected in ((1e-5 * north, -speed), (1e-5 * east, 1j * speed)):
        assert_allclose(geostrophic_flow(height, places, latitude), expected, rtol=1e-12)


@needs(DATA / "models")
def test_real_nemo_labelled_eastward_by_mistake():
    files = [DATA / "models" / f"nemo_ORCA025_{name}.nc" for name in ("U", "V", "coordinates")]
    part = {"region": (-10.0, 60.0, 10.0, 75.0), "levels": (50.0,)}
    right, wrong = (describe_ensemble(files, ForecastConfig(**part, **a)) for a in ({}, AS_TRUE))
    assert (right.names, right.check.axes) == (("uo", "vo"), "grid")
    assert "C-grid" in right.arrangement
    assert (right.check.contradicted, wrong.check.contradicted) == (False, True)
    assert right.check.residual == pytest.approx(wrong.check.residual[::-1], abs=2e-3)
    assert [path.name for path in right.grids] == ["nemo_ORCA025_coordinates.nc"]
