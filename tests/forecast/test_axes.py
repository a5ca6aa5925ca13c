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
from replay_kit.forecast.grids.axes import divergent_share, geostrophic_flow
from tests.forecast import forms
from tests.forecast.forms import read_with, save
from tests.places import DATA

SHAPE = (20, 22)


def flow(angle_deg, standard_names, sea_level=False, members=2):
    """A geostrophic current of eddies along the axes of a turned grid, labelled as asked."""
    at = forms.rotated(angle_deg, shape=SHAPE, cell=0.04)
    j, i = np.meshgrid(np.arange(float(SHAPE[0])), np.arange(float(SHAPE[1])), indexing="ij")
    longitude, latitude = at(j, i)
    east, north = to_local(Projection(5.0, 60.0), longitude, latitude)
    heights = [
        0.1 * np.sin(east / (9e3 + 1e3 * k)) * np.cos(north / 1.1e4 + k) for k in range(members)
    ]
    components = []
    for height in heights:
        turned = geostrophic_flow(height, (east, north), latitude) * np.exp(
            -1j * np.deg2rad(angle_deg)
        )
        components.append((turned.real, turned.imag))
    dims, space = ("member", "y", "x"), ("y", "x")
    ds = xr.Dataset(
        {
            name: (
                dims,
                np.stack([part[k] for part in components]),
                {"standard_name": standard, "units": "m s-1"},
            )
            for k, (name, standard) in enumerate(zip(("uo", "vo"), standard_names, strict=True))
        },
        {"longitude": (space, longitude), "latitude": (space, latitude)},
    )
    if sea_level:
        ds["zos"] = (dims, np.stack(heights), {"units": "m"})
    return ds


TRUE = ("eastward_sea_water_velocity", "northward_sea_water_velocity")
GRID = ("sea_water_x_velocity", "sea_water_y_velocity")


@pytest.mark.parametrize("sea_level", [False, True])
@pytest.mark.parametrize(("names", "right"), [(TRUE, False), (GRID, True)])
def test_a_wrong_label_is_told_with_the_option_that_mends_it(tmp_path, names, right, sea_level):
    path = save(flow(44.0, names, sea_level), tmp_path / "e.nc")
    found = describe_ensemble(path, ForecastConfig())
    assert found.check.angle == pytest.approx(44.0, abs=0.5)
    assert found.check.contradicted is not right
    as_read, turned = found.check.residual
    assert (as_read < 0.01 < 0.1 < turned) if right else (turned < 0.01 < 0.1 < as_read)
    warned = [
        note
        for note in found.ensemble.notes
        if note.startswith("WARNING: the velocities are used as read")
    ]
    assert len(warned) == (0 if right else 1)
    if not right:
        assert (
            "true east and north (standard name eastward_sea_water_velocity), but fit the grid's axes better"
            in warned[0]
        )
        assert "--axes grid turns them, --axes true keeps this reading" in warned[0]
        rms = np.sqrt(np.mean(found.ensemble.velocity**2))
        assert found.ensemble.representation_error_std == pytest.approx(
            np.sqrt(as_read) * rms, rel=0.05
        )
        assert (
            f"{100 * found.ensemble.representation_error_std:.1f} cm/s count as representation error"
            in warned[0]
        )
        basis = build_basis([found.ensemble], EstimatorConfig(modes=1))
        trusted = build_basis(
            [replace(found.ensemble, representation_error_std=0.0)], EstimatorConfig(modes=1)
        )
        expected = np.hypot(trusted.representation, found.ensemble.representation_error_std)
        assert_allclose(basis.representation, expected, rtol=1e-12)
        kept = describe_ensemble(path, ForecastConfig(axes="true"))
        assert kept.check.contradicted
        assert kept.ensemble.notes == ()
        assert kept.ensemble.representation_error_std == 0.0
    if sea_level:
        # read along true axes, the current lies 44 degrees to the right of the geostrophic one
        assert found.check.phase == pytest.approx((0.0, -44.0) if right else (-44.0, 0.0), abs=1.0)
    mended = describe_ensemble(path, ForecastConfig(axes="grid"))
    assert not mended.check.contradicted
    assert mended.ensemble.representation_error_std == 0.0
    assert mended.check.why == "--axes grid"
    assert_array_equal(
        mended.ensemble.velocity,
        read_with(save(flow(44.0, GRID), tmp_path / "g.nc")).velocity,
    )


def test_below_a_degree_nothing_is_asked(tmp_path):
    check = describe_ensemble(
        save(flow(0.3, TRUE, True), tmp_path / "e.nc"), ForecastConfig()
    ).check
    assert 0.2 < check.angle < 1.0
    assert (check.residual, check.phase) == (None, None)


def test_the_share_of_a_divergent_flow_is_all_and_of_a_rotation_none():
    east, north = np.meshgrid(np.arange(30.0) * 4e3, np.arange(25.0) * 4e3)
    wet = np.ones(east.shape, bool)
    wet[:4, :6] = False
    x, y = 2 * np.pi * east / 4e4, 2 * np.pi * north / 4e4
    gradient = (np.cos(x) * np.sin(y) + 1j * np.sin(x) * np.cos(y))[None]
    rotation = (-np.sin(x) * np.cos(y) + 1j * np.cos(x) * np.sin(y))[None]
    assert divergent_share(east, north, rotation, wet) < 0.01
    assert divergent_share(east, north, gradient, wet) > 0.8
    # of both together, half of the variance is divergent
    assert divergent_share(east, north, gradient + rotation, wet) == pytest.approx(0.5, abs=0.1)


def test_geostrophic_flow_goes_round_a_high_clockwise_in_the_north():
    east, north = np.meshgrid(np.arange(5.0) * 1e4, np.arange(4.0) * 1e4)
    latitude = np.full(east.shape, 45.0)
    found = geostrophic_flow(1e-5 * north, (east, north), latitude)
    assert_allclose(found, -9.81e-5 / (2 * 7.2921e-5 * np.sin(np.pi / 4)), rtol=1e-12)
    found = geostrophic_flow(1e-5 * east, (east, north), latitude)
    assert_allclose(found, 1j * 9.81e-5 / (2 * 7.2921e-5 * np.sin(np.pi / 4)), rtol=1e-12)


def test_real_nemo_labelled_eastward_by_mistake():
    files = [DATA / "models" / f"nemo_ORCA025_{name}.nc" for name in ("U", "V", "coordinates")]
    if not files[0].exists():
        pytest.skip("the shared data are not on this machine")
    region, levels = (-10.0, 60.0, 10.0, 75.0), (50.0,)
    right = describe_ensemble(files, ForecastConfig(region=region, levels=levels))
    wrong = describe_ensemble(files, ForecastConfig(region=region, levels=levels, axes="true"))
    assert right.names == ("uo", "vo")
    assert "C-grid" in right.arrangement
    assert right.check.axes == "grid"
    assert not right.check.contradicted
    assert wrong.check.contradicted
    assert right.check.residual == pytest.approx(wrong.check.residual[::-1], abs=2e-3)
    assert [path.name for path in right.grids] == ["nemo_ORCA025_coordinates.nc"]
