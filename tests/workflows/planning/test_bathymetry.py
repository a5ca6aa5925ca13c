"""Bathymetry under the names and signs of GEBCO, ETOPO, NEMO and ROMS files, and what is wrong with others."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from planners import Bathymetry
from replay_kit.config.planner import PlannerConfig
from replay_kit.core.errors import ConfigError, ForecastError
from replay_kit.workflows.planning import MissionPlanner, planner_of
from replay_kit.workflows.planning.bathymetry import bathymetry_notes, read_bathymetry
from tests.planners.flow_samples import place, still_flow

LONGITUDE, LATITUDE = np.linspace(151.9, 153.1, 25), np.linspace(-40.5, -39.5, 11)
DEPTH = np.add.outer(100.0 * np.arange(11.0), 7.0 * np.arange(25.0)) - 50.0
CURVED = np.meshgrid(LONGITUDE, LATITUDE)


def gebco() -> xr.Dataset:
    attributes = {"standard_name": "height_above_mean_sea_level", "units": "m"}
    return xr.Dataset({"elevation": (("lat", "lon"), -DEPTH, attributes)}, {"lat": LATITUDE, "lon": LONGITUDE})


def etopo() -> xr.Dataset:
    made = xr.Dataset({"z": (("y", "x"), -DEPTH)}, {"y": LATITUDE, "x": LONGITUDE})
    made["x"].attrs["units"], made["y"].attrs["units"] = "degrees_east", "degrees_north"
    return made


def nemo() -> xr.Dataset:
    fields = {"Bathymetry": (("y", "x"), DEPTH), "nav_lon": (("y", "x"), CURVED[0]), "nav_lat": (("y", "x"), CURVED[1])}
    return xr.Dataset(fields)


def static() -> xr.Dataset:
    attributes = {"standard_name": "sea_floor_depth_below_geoid", "units": "km"}
    depth = ("time", "longitude", "latitude"), DEPTH.T[None] / 1e3, attributes
    return xr.Dataset({"deptho": depth}, {"time": [0.0], "longitude": LONGITUDE + 360.0, "latitude": LATITUDE})


def roms() -> xr.Dataset:
    rho = ("eta_rho", "xi_rho")
    made = {
        "h": (rho, np.maximum(DEPTH, 10.0), {"units": "meter"}),
        "mask_rho": (rho, (DEPTH > 0.0).astype(float)),
        "angle": (rho, 0.0 * DEPTH),
    }
    return xr.Dataset(made, {"lon_rho": (rho, CURVED[0]), "lat_rho": (rho, CURVED[1])})


def written(path: Path, dataset: xr.Dataset) -> Path:
    dataset.to_netcdf(path / "bottom.nc", engine="h5netcdf")
    return path / "bottom.nc"


@pytest.mark.parametrize("make", [gebco, etopo, nemo, static, roms])
def test_depths_are_positive_down_in_metres(make, tmp_path):
    read = read_bathymetry(written(tmp_path, make()))
    wet = DEPTH > 0.0
    np.testing.assert_allclose(read.depth[wet], np.maximum(DEPTH, 10.0)[wet] if make is roms else DEPTH[wet], rtol=1e-12)
    assert not np.any(read.depth[~wet] > 0.0)
    np.testing.assert_allclose(np.mod(read.longitude, 360.0), CURVED[0], rtol=1e-12)
    np.testing.assert_allclose(read.latitude, CURVED[1], rtol=1e-12)


def test_the_attribute_positive_decides_the_sign(tmp_path):
    turned = gebco()
    turned["elevation"] = -turned["elevation"].assign_attrs(positive="down")
    turned["elevation"].attrs = {"positive": "down", "units": "m"}
    np.testing.assert_allclose(read_bathymetry(written(tmp_path, turned)).depth, DEPTH)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"units": "fathom"}, "expected metres"),
        ({"positive": "sideways"}, "expected up or down"),
    ],
)
def test_attributes_that_are_not_understood_are_refused(change, words, tmp_path):
    wrong = gebco()
    wrong["elevation"].attrs |= change
    with pytest.raises(ForecastError, match=words):
        read_bathymetry(written(tmp_path, wrong))


def test_a_sign_that_leaves_no_water_and_axes_that_are_missing_are_refused(tmp_path):
    with pytest.raises(ForecastError, match='elevation as a height, positive up, has no water; give it the attribute positive = "down"'):
        read_bathymetry(written(tmp_path, gebco().assign(elevation=(("lat", "lon"), DEPTH + 60.0))))
    with pytest.raises(ForecastError, match='depth, positive down, has no water; give it the attribute positive = "up"'):
        read_bathymetry(written(tmp_path, nemo().assign(Bathymetry=(("y", "x"), -DEPTH - 60.0))))
    with pytest.raises(ForecastError, match="on longitude and latitude, found z"):
        read_bathymetry(written(tmp_path, xr.Dataset({"z": (("y", "x"), -DEPTH)})))


def test_gaps_wide_cells_and_water_that_is_not_covered_are_noted():
    grid, (longitude, latitude) = still_flow().grid, CURVED
    assert bathymetry_notes(Bathymetry(longitude, latitude, DEPTH), grid) == ()
    holed = DEPTH.copy()
    holed[5, 10:12] = np.nan
    (gaps,) = bathymetry_notes(Bathymetry(longitude, latitude, holed), grid)
    assert "no depth at 2 of its" in gaps
    wide = np.s_[::3, ::6]
    (coarse,) = bathymetry_notes(Bathymetry(longitude[wide], latitude[wide], DEPTH[wide]), replace(grid, latitude=grid.latitude))[:1]
    assert "are 25.6 km apart, wider than the forecast's, 8.5 km" in coarse
    part = np.s_[:, :20]
    (short,) = bathymetry_notes(Bathymetry(longitude[part], latitude[part], DEPTH[part]), grid)
    assert "does not cover all of the region" in short


def test_a_replay_s_missions_turn_above_the_bottom(tmp_path):
    flat = gebco().assign(elevation=(("lat", "lon"), np.full(DEPTH.shape, -100.0)))
    path, flow = written(tmp_path, flat), still_flow()
    planner = planner_of(PlannerConfig(kind="mission", depth=300.0, bathymetry=str(path), clearance=30.0))
    assert isinstance(planner, MissionPlanner)
    made = planner.plan(flow, place(flow, -2e3, 0.0, 0.0), place(flow, 2e3, 0.0, 0.0), 0, None).memory
    assert {max(leg) for leg in made.yo_depths} == {70.0}
    assert made.status == "reached"
    with pytest.raises(ConfigError, match="only a mission turns above the bottom"):
        planner_of(PlannerConfig(bathymetry=str(path)))
