"""Bathymetry under the names and signs of GEBCO, ETOPO, NEMO and ROMS files, and what is wrong with others."""

import tracemalloc
from dataclasses import replace
from pathlib import Path

import h5netcdf
import numpy as np
import pytest
import xarray as xr

from planners import Bathymetry
from replay_kit.config.planner import PlannerConfig
from replay_kit.core.errors import ForecastError, PlanError
from replay_kit.core.geodesy import to_geographic, to_local
from replay_kit.core.grid import Grid, Projection
from replay_kit.workflows.planning.adapters import MissionPlanner, planner_of
from replay_kit.workflows.planning.bathymetry import (
    bathymetry_notes,
    depth_at,
    read_bathymetry,
    seabed_of,
)
from replay_kit.workflows.replay.stages.planner import PlanQuery
from tests.planners.flow_samples import place, still_flow

LONGITUDE, LATITUDE = np.linspace(151.9, 153.1, 25), np.linspace(-40.5, -39.5, 11)
DEPTH = np.add.outer(100.0 * np.arange(11.0), 7.0 * np.arange(25.0)) - 50.0
CURVED = np.meshgrid(LONGITUDE, LATITUDE)


def region(longitude, latitude) -> Grid:
    """A region of 3 x 4 points between two longitudes and two latitudes, continuous."""
    projection = Projection((np.mean(longitude) + 180.0) % 360.0 - 180.0, float(np.mean(latitude)))
    x, y = np.meshgrid(np.linspace(*longitude, 4), np.linspace(*latitude, 3))
    return Grid(
        projection, x, y, *to_local(projection, x, y), np.array([5.0]), np.full((1, 3, 4), True)
    )


WHOLE = region((151.9, 153.1), (-40.5, -39.5))


def gebco() -> xr.Dataset:
    attributes = {"standard_name": "height_above_mean_sea_level", "units": "m"}
    return xr.Dataset(
        {"elevation": (("lat", "lon"), -DEPTH, attributes)}, {"lat": LATITUDE, "lon": LONGITUDE}
    )


def etopo() -> xr.Dataset:
    made = xr.Dataset({"z": (("y", "x"), -DEPTH)}, {"y": LATITUDE, "x": LONGITUDE})
    made["x"].attrs["units"], made["y"].attrs["units"] = "degrees_east", "degrees_north"
    return made


def nemo() -> xr.Dataset:
    fields = {
        "Bathymetry": (("y", "x"), DEPTH),
        "nav_lon": (("y", "x"), CURVED[0]),
        "nav_lat": (("y", "x"), CURVED[1]),
    }
    return xr.Dataset(fields)


def static() -> xr.Dataset:
    attributes = {"standard_name": "sea_floor_depth_below_geoid", "units": "km"}
    depth = ("time", "longitude", "latitude"), DEPTH.T[None] / 1e3, attributes
    return xr.Dataset(
        {"deptho": depth}, {"time": [0.0], "longitude": LONGITUDE + 360.0, "latitude": LATITUDE}
    )


def roms() -> xr.Dataset:
    rho = ("eta_rho", "xi_rho")
    made = {
        "h": (rho, np.maximum(DEPTH, 10.0), {"units": "meter"}),
        "mask_rho": (rho, (DEPTH > 0.0).astype(float)),
        "angle": (rho, 0.0 * DEPTH),
    }
    return xr.Dataset(made, {"lon_rho": (rho, CURVED[0]), "lat_rho": (rho, CURVED[1])})


def written(path: Path, dataset: xr.Dataset, engine: str = "h5netcdf") -> Path:
    dataset.to_netcdf(path / "bottom.nc", engine=engine)
    return path / "bottom.nc"


@pytest.mark.parametrize("make", [gebco, etopo, nemo, static, roms])
@pytest.mark.parametrize("engine", ["h5netcdf", "scipy"])
def test_depths_are_positive_down_in_metres(make, engine, tmp_path):
    read = read_bathymetry(written(tmp_path, make(), engine), WHOLE)
    wet = DEPTH > 0.0
    np.testing.assert_allclose(
        read.depth[wet], np.maximum(DEPTH, 10.0)[wet] if make is roms else DEPTH[wet], rtol=1e-12
    )
    assert not np.any(read.depth[~wet] > 0.0)
    np.testing.assert_allclose(np.mod(read.longitude, 360.0), CURVED[0], rtol=1e-12)
    np.testing.assert_allclose(read.latitude, CURVED[1], rtol=1e-12)


@pytest.mark.parametrize(
    ("name", "attributes"),
    [("zeta", {}), ("eta", {"standard_name": "sea_surface_height_above_geoid"})],
)
def test_depths_are_those_at_lowest_water_where_the_file_has_its_level(name, attributes, tmp_path):
    tide = np.array([0.4, -1.5, 0.9])[:, None, None] + 0.01 * np.arange(25.0)
    level = np.where(DEPTH > 0.0, np.broadcast_to(tide, (3, *DEPTH.shape)), np.nan)
    made = roms().assign({name: (("ocean_time", "eta_rho", "xi_rho"), 100.0 * level)})
    made[name].attrs |= {"units": "cm", **attributes}
    plain, low = (read_bathymetry(written(tmp_path, one), WHOLE) for one in (roms(), made))
    wet = DEPTH > 0.0
    expected = plain.depth + (-1.5 + 0.01 * np.arange(25.0))
    np.testing.assert_allclose(low.depth[wet], expected[wet], rtol=1e-12)
    assert low.lowest_water == pytest.approx((-1.5, -1.26))
    (note,) = set(bathymetry_notes(low, WHOLE)) - set(bathymetry_notes(plain, WHOLE))
    assert "lowest water, -1.5 to -1.3 m" in note


def test_a_single_number_is_no_axis(tmp_path):
    read = read_bathymetry(
        written(tmp_path, gebco().assign_coords(longitude=5.0, latitude=60.0)), WHOLE
    )
    np.testing.assert_array_equal(
        read.longitude, read_bathymetry(written(tmp_path, gebco()), WHOLE).longitude
    )


def test_the_attribute_positive_decides_the_sign(tmp_path):
    turned = gebco()
    turned["elevation"] = -turned["elevation"].assign_attrs(positive="down")
    turned["elevation"].attrs = {"positive": "down", "units": "m"}
    np.testing.assert_allclose(read_bathymetry(written(tmp_path, turned), WHOLE).depth, DEPTH)


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
        read_bathymetry(written(tmp_path, wrong), WHOLE)


def test_a_sign_that_leaves_no_water_and_axes_that_are_missing_are_refused(tmp_path):
    with pytest.raises(
        ForecastError,
        match='elevation as a height, positive up, has no water; give it the attribute positive = "down"',
    ):
        read_bathymetry(
            written(tmp_path, gebco().assign(elevation=(("lat", "lon"), DEPTH + 60.0))), WHOLE
        )
    with pytest.raises(
        ForecastError,
        match='depth, positive down, has no water; give it the attribute positive = "up"',
    ):
        read_bathymetry(
            written(tmp_path, nemo().assign(Bathymetry=(("y", "x"), -DEPTH - 60.0))), WHOLE
        )
    for name, words in (("z", "on longitude and latitude, found z"), ("speed", "expected one of")):
        with pytest.raises(ForecastError, match=words):
            read_bathymetry(written(tmp_path, xr.Dataset({name: (("y", "x"), -DEPTH)})), WHOLE)
    with pytest.raises(ForecastError, match=r"missing\.nc: no such file"):
        read_bathymetry(tmp_path / "missing.nc", WHOLE)


def test_gaps_wide_cells_and_water_that_is_not_covered_are_noted():
    grid, (longitude, latitude) = still_flow().grid, CURVED
    assert bathymetry_notes(Bathymetry(longitude, latitude, DEPTH), grid) == ()
    holed = DEPTH.copy()
    holed[5, 10:12] = np.nan
    (gaps,) = bathymetry_notes(Bathymetry(longitude, latitude, holed), grid)
    assert "no depth at 2 of its" in gaps
    wide = np.s_[::3, ::6]
    (coarse,) = bathymetry_notes(
        Bathymetry(longitude[wide], latitude[wide], DEPTH[wide]),
        replace(grid, latitude=grid.latitude),
    )[:1]
    assert "are 25.6 km apart, wider than the forecast's, 8.5 km" in coarse
    part = np.s_[:, :20]
    (short,) = bathymetry_notes(Bathymetry(longitude[part], latitude[part], DEPTH[part]), grid)
    assert "does not cover the whole region" in short


def above_flat_bottom(folder, **settings):
    """A flow, and a planner above a bottom at 100 m."""
    flat = gebco().assign(elevation=(("lat", "lon"), np.full(DEPTH.shape, -100.0)))
    path, flow = written(folder, flat), still_flow()
    config = PlannerConfig(bathymetry=str(path), clearance=30.0, **settings)
    return flow, planner_of(config, flow.grid)


def test_a_replay_s_missions_turn_above_the_bottom(tmp_path):
    flow, planner = above_flat_bottom(tmp_path, kind="mission", depth=300.0)
    assert isinstance(planner, MissionPlanner)
    found = planner.plan(
        flow, PlanQuery(place(flow, -2e3, 0.0, 0.0), place(flow, 2e3, 0.0, 0.0), 0)
    )
    made = found.memory
    assert {max(leg) for leg in made.yo_depths} == {70.0}
    assert made.status == "reached"
    np.testing.assert_allclose(found.plan.bottom, 100.0, rtol=1e-12)
    assert planner.seabed.depth.shape == (15, 19)
    np.testing.assert_allclose(planner.seabed.depth, 100.0, rtol=1e-12)


def test_a_glide_ends_above_the_bottom(tmp_path):
    flow, planner = above_flat_bottom(tmp_path)
    assert planner.glides
    start = place(flow, -2e3, 0.0, 0.0)
    above = planner.plan(flow, PlanQuery(start, place(flow, 2e3, 0.0, 69.0), 0)).plan
    assert (above.status, above.track[-1, 2]) == ("reached", pytest.approx(69.0, abs=0.1))
    np.testing.assert_allclose(above.bottom, 100.0, rtol=1e-12)
    with pytest.raises(
        PlanError, match="the bottom less a clearance of 30 m leaves 70 m; move it to deeper water"
    ):
        planner.plan(flow, PlanQuery(start, place(flow, 2e3, 0.0, 71.0), 0))


def test_no_more_of_a_grid_of_the_world_is_read_than_lies_around_the_region(tmp_path):
    # as large as ETOPO's of a minute: its chunks are not allocated, and all of it would take 1.9 GB as float64
    with h5netcdf.File(tmp_path / "world.nc", "w") as file:
        file.dimensions = {"lat": 10_800, "lon": 21_600}
        for name, half in (("lat", 90.0), ("lon", 180.0)):
            count = file.dimensions[name].size
            variable = file.create_variable(name, (name,), "f8")
            variable[:] = -half + 2.0 * half * (np.arange(count) + 0.5) / count
        heights = file.create_variable("elevation", ("lat", "lon"), "i2", chunks=(240, 240))
        heights[8_975:9_025, 11_375:11_450] = -4000
        heights[22:260, :] = -4000
        heights[25:28, :] = -25
    step = 1.0 / 60.0
    tracemalloc.start()
    here = read_bathymetry(tmp_path / "world.nc", region((10.0, 10.5), (60.0, 60.25)))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 50e6
    # half a cell off the ends, and two points beyond
    assert here.depth.shape == (15 + 4, 30 + 4)
    assert (here.depth == 4000.0).all()
    np.testing.assert_allclose(
        here.longitude[0, [0, -1]], [10.0 - 1.5 * step, 10.5 + 1.5 * step], rtol=1e-12
    )
    np.testing.assert_allclose(
        here.latitude[[0, -1], 0], [60.0 - 1.5 * step, 60.25 + 1.5 * step], rtol=1e-12
    )
    seam = read_bathymetry(tmp_path / "world.nc", region((179.9, 180.2), (-89.6, -89.55)))
    assert seam.depth.shape == (3 + 4, 18 + 4)
    np.testing.assert_allclose(np.diff(seam.longitude[0]), step, rtol=1e-6)
    assert seam.longitude[0, 0] == pytest.approx(179.9 - 1.5 * step)
    assert set(seam.depth[:, 0].tolist()) == {4000.0, 25.0}


def test_a_window_of_a_curved_grid_is_cut_by_rows_and_columns(tmp_path):
    cut = read_bathymetry(written(tmp_path, nemo()), region((152.41, 152.59), (-40.05, -39.95)))
    # longitudes 152.45 to 152.55 and latitude -40, and two beyond
    np.testing.assert_allclose(cut.longitude[0], np.arange(152.35, 152.66, 0.05), rtol=1e-9)
    np.testing.assert_allclose(cut.latitude[:, 0], [-40.2, -40.1, -40.0, -39.9, -39.8], rtol=1e-9)
    np.testing.assert_allclose(cut.depth, DEPTH[3:8, 9:16])
    outside = read_bathymetry(written(tmp_path, nemo()), region((10.0, 11.0), (-40.2, -39.9)))
    assert outside.depth.shape == DEPTH.shape


def test_the_bottom_under_a_track_is_linear_between_the_points(tmp_path):
    bathymetry = read_bathymetry(written(tmp_path, gebco()), WHOLE)
    longitude = np.array([152.0, 152.025, 152.333, 151.0])
    latitude = np.array([-40.0, -40.05, -39.9, -40.0])
    east, north = to_local(WHOLE.projection, longitude, latitude)
    found = depth_at(bathymetry, WHOLE.projection, east, north)
    expected = -50.0 + 1000.0 * (latitude + 40.5) + 140.0 * (longitude - 151.9)
    np.testing.assert_allclose(found[:3], expected[:3], atol=0.5)
    assert np.isnan(found[3])
    assert depth_at(bathymetry, WHOLE.projection, east[:0], north[:0]).shape == (0,)


def test_the_grid_of_results_has_at_most_160_cells_a_side():
    x, y = np.meshgrid(np.linspace(151.9, 153.1, 500), np.linspace(-40.5, -39.5, 30))
    inner = region((152.0, 153.0), (-40.4, -39.6))
    found = seabed_of(Bathymetry(x, y, 100.0 + 1000.0 * (y + 40.5)), inner)
    assert found.depth.shape == (160, 160)
    np.testing.assert_allclose(
        [found.east[0], found.east[-1]], [inner.east.min(), inner.east.max()]
    )
    latitude = to_geographic(inner.projection, *np.meshgrid(found.east, found.north))[1]
    np.testing.assert_allclose(found.depth, 100.0 + 1000.0 * (latitude + 40.5), atol=0.01)


def test_two_million_points_of_a_region_are_read(tmp_path):
    longitude, latitude = np.linspace(151.8, 153.2, 1900), np.linspace(-40.6, -39.4, 1500)
    height = -np.random.default_rng(1).integers(100, 5000, (1500, 1900)).astype(np.int16)
    attributes = {"standard_name": "height_above_mean_sea_level", "units": "m"}
    axes = {"lat": latitude, "lon": longitude}
    file = xr.Dataset({"elevation": (("lat", "lon"), height, attributes)}, axes)
    file.to_netcdf(path := tmp_path / "bottom.nc", encoding={"elevation": {"zlib": True}})
    assert read_bathymetry(path, WHOLE).depth.size > 2e6
