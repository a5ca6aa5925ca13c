"""Bathymetry under the names and signs of GEBCO, ETOPO, NEMO and ROMS files, and what is wrong with others."""

import tracemalloc

import h5netcdf
import numpy as np
import pytest
import xarray as xr

from planners import Bathymetry
from replay_kit.config.planner import PlannerConfig
from replay_kit.core.errors import ForecastError, PlanError
from replay_kit.core.geodesy import to_geographic, to_local
from replay_kit.core.grid import Grid, Projection
from replay_kit.workflows.planning.adapters import planner_of
from replay_kit.workflows.planning.bathymetry import (
    bathymetry_notes,
    depth_at,
    read_bathymetry,
    seabed_of,
)
from replay_kit.workflows.replay.inputs.planner import PlanQuery
from tests.planners.flow_samples import place, still_flow

LONGITUDE, LATITUDE = np.linspace(151.9, 153.1, 25), np.linspace(-40.5, -39.5, 11)
DEPTH = np.add.outer(100.0 * np.arange(11.0), 7.0 * np.arange(25.0)) - 50.0
WET = DEPTH > 0.0
CURVED = np.meshgrid(LONGITUDE, LATITUDE)


def region(longitude, latitude) -> Grid:
    """A region of 3 x 4 points between two longitudes and two latitudes, continuous."""
    projection = Projection((np.mean(longitude) + 180.0) % 360.0 - 180.0, float(np.mean(latitude)))
    x, y = np.meshgrid(np.linspace(*longitude, 4), np.linspace(*latitude, 3))
    wet = np.full((1, 3, 4), True)
    return Grid(projection, x, y, *to_local(projection, x, y), np.array([5.0]), wet)


WHOLE = region((151.9, 153.1), (-40.5, -39.5))


def gebco(height=-DEPTH, **attributes) -> xr.Dataset:
    named = {"standard_name": "height_above_mean_sea_level", "units": "m"} | attributes
    axes = {"lat": LATITUDE, "lon": LONGITUDE}
    return xr.Dataset({"elevation": (("lat", "lon"), height, named)}, axes)


def etopo() -> xr.Dataset:
    made = xr.Dataset({"z": (("y", "x"), -DEPTH)}, {"y": LATITUDE, "x": LONGITUDE})
    made["x"].attrs["units"], made["y"].attrs["units"] = "degrees_east", "degrees_north"
    return made


def nemo(depth=DEPTH) -> xr.Dataset:
    fields = {"Bathymetry": depth, "nav_lon": CURVED[0], "nav_lat": CURVED[1]}
    return xr.Dataset({name: (("y", "x"), values) for name, values in fields.items()})


def static() -> xr.Dataset:
    attributes = {"standard_name": "sea_floor_depth_below_geoid", "units": "km"}
    depth = ("time", "longitude", "latitude"), DEPTH.T[None] / 1e3, attributes
    axes = {"time": [0.0], "longitude": LONGITUDE + 360.0, "latitude": LATITUDE}
    return xr.Dataset({"deptho": depth}, axes)


def roms() -> xr.Dataset:
    rho = ("eta_rho", "xi_rho")
    made = {
        "h": (rho, np.maximum(DEPTH, 10.0), {"units": "meter"}),
        "mask_rho": (rho, WET.astype(float)),
        "angle": (rho, 0.0 * DEPTH),
    }
    return xr.Dataset(made, {"lon_rho": (rho, CURVED[0]), "lat_rho": (rho, CURVED[1])})


def read(folder, dataset, grid=WHOLE, engine="h5netcdf") -> Bathymetry:
    dataset.to_netcdf(folder / "bottom.nc", engine=engine)
    return read_bathymetry(folder / "bottom.nc", grid)


@pytest.mark.parametrize(
    ("dataset", "engine"),
    [
        (gebco(), "h5netcdf"),
        (gebco(), "scipy"),
        (gebco(DEPTH, positive="down", standard_name="depth"), "h5netcdf"),
        # a single number is no axis
        (gebco().assign_coords(longitude=5.0, latitude=60.0), "h5netcdf"),
        (etopo(), "scipy"),
        (nemo(), "h5netcdf"),
        (static(), "h5netcdf"),
        (roms(), "scipy"),
    ],
)
def test_depths_are_positive_down_in_metres(dataset, engine, tmp_path):
    found = read(tmp_path, dataset, engine=engine)
    expected = np.maximum(DEPTH, 10.0) if "h" in dataset else DEPTH
    np.testing.assert_allclose(found.depth[WET], expected[WET], rtol=1e-12)
    assert not np.any(found.depth[~WET] > 0.0)
    np.testing.assert_allclose(np.mod(found.longitude, 360.0), CURVED[0], rtol=1e-12)
    np.testing.assert_allclose(found.latitude, CURVED[1], rtol=1e-12)


@pytest.mark.parametrize(
    ("dataset", "words"),
    [
        (gebco(units="fathom"), "expected metres"),
        (gebco(positive="sideways"), "expected up or down"),
        (gebco(DEPTH + 60.0), 'no water; give it the attribute positive = "down"'),
        (nemo(-DEPTH - 60.0), 'no water; give it the attribute positive = "up"'),
        (xr.Dataset({"z": (("y", "x"), -DEPTH)}), "on longitude and latitude, found z"),
        (xr.Dataset({"speed": (("y", "x"), -DEPTH)}), "expected one of"),
    ],
)
def test_what_is_not_understood_is_refused(dataset, words, tmp_path):
    with pytest.raises(ForecastError, match=words):
        read(tmp_path, dataset)


def test_gaps_and_water_that_is_not_covered_are_noted():
    grid, holed = still_flow().grid, DEPTH.copy()
    holed[5, 10:12] = np.nan
    for depth, part, words in (
        (DEPTH, np.s_[:], None),
        (holed, np.s_[:], "no depth at 2 of its"),
        (DEPTH, np.s_[:, :20], "does not cover the whole region"),
    ):
        told = bathymetry_notes(Bathymetry(*(one[part] for one in (*CURVED, depth))), grid)
        assert words in told[0] if words else told == ()


def planned(folder, goal, **settings):
    """The planner above a bottom at 100 m with a clearance of 30 m, and its plan to a place at a depth."""
    path, flow = folder / "flat.nc", still_flow()
    gebco(np.full(DEPTH.shape, -100.0)).to_netcdf(path, engine="h5netcdf")
    config = PlannerConfig(bathymetry=str(path), clearance=30.0, **settings)
    planner, start = planner_of(config, flow.grid), place(flow, -2e3, 0.0, 0.0)
    found = planner.plan(flow, PlanQuery(start, place(flow, 2e3, 0.0, goal), 0))
    np.testing.assert_allclose(found.plan.bottom, 100.0, rtol=1e-12)
    return planner, found


def test_a_replay_s_missions_turn_above_the_bottom(tmp_path):
    planner, found = planned(tmp_path, 0.0, kind="mission", depth=300.0)
    assert {max(leg) for leg in found.memory.yo_depths} == {70.0}
    assert found.memory.status == "reached"
    assert planner.seabed.depth.shape == (15, 19)
    np.testing.assert_allclose(planner.seabed.depth, 100.0, rtol=1e-12)


def test_a_glide_ends_above_the_bottom(tmp_path):
    above = planned(tmp_path, 69.0)[1].plan
    assert (above.status, above.track[-1, 2]) == ("reached", pytest.approx(69.0, abs=0.1))
    with pytest.raises(PlanError, match="less a clearance of 30 m leaves 70 m"):
        planned(tmp_path, 71.0)


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
    off = 1.5 / 60.0
    tracemalloc.start()
    here = read_bathymetry(tmp_path / "world.nc", region((10.0, 10.5), (60.0, 60.25)))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 50e6
    # half a cell off the ends, and two points beyond
    assert here.depth.shape == (15 + 4, 30 + 4)
    assert (here.depth == 4000.0).all()
    for axis, ends in (
        (here.longitude[0, [0, -1]], [10.0 - off, 10.5 + off]),
        (here.latitude[[0, -1], 0], [60.0 - off, 60.25 + off]),
    ):
        np.testing.assert_allclose(axis, ends, rtol=1e-12)
    seam = read_bathymetry(tmp_path / "world.nc", region((179.9, 180.2), (-89.6, -89.55)))
    assert seam.depth.shape == (3 + 4, 18 + 4)
    np.testing.assert_allclose(np.diff(seam.longitude[0]), 1.0 / 60.0, rtol=1e-6)
    assert seam.longitude[0, 0] == pytest.approx(179.9 - off)
    assert set(seam.depth[:, 0].tolist()) == {4000.0, 25.0}


def test_a_window_of_a_curved_grid_is_cut_by_rows_and_columns(tmp_path):
    cut = read(tmp_path, nemo(), region((152.41, 152.59), (-40.05, -39.95)))
    # longitudes 152.45 to 152.55 and latitude -40, and two beyond
    window = np.s_[3:8, 9:16]
    for found, all_of_it in (
        (cut.longitude, CURVED[0]),
        (cut.latitude, CURVED[1]),
        (cut.depth, DEPTH),
    ):
        np.testing.assert_allclose(found, all_of_it[window])
    outside = read(tmp_path, nemo(), region((10.0, 11.0), (-40.2, -39.9)))
    assert outside.depth.shape == DEPTH.shape


def test_the_bottom_under_a_track_is_linear_between_the_points():
    longitude = np.array([152.0, 152.025, 152.333, 151.0])
    latitude = np.array([-40.0, -40.05, -39.9, -40.0])
    at = to_local(WHOLE.projection, longitude, latitude)
    bottom = Bathymetry(*CURVED, DEPTH)
    found = depth_at(bottom, WHOLE.projection, *at)
    expected = -50.0 + 1000.0 * (latitude + 40.5) + 140.0 * (longitude - 151.9)
    np.testing.assert_allclose(found[:3], expected[:3], atol=0.5)
    assert np.isnan(found[3])
    assert depth_at(bottom, WHOLE.projection, *np.empty((2, 0))).shape == (0,)


def test_the_grid_of_results_has_at_most_160_cells_a_side():
    x, y = np.meshgrid(np.linspace(151.9, 153.1, 500), LATITUDE)
    inner = region((152.0, 153.0), (-40.4, -39.6))
    found = seabed_of(Bathymetry(x, y, 1000.0 * (y + 40.6)), inner)
    assert found.depth.shape == (160, 160)
    assert found.east[[0, -1]] == pytest.approx([inner.east.min(), inner.east.max()])
    latitude = to_geographic(inner.projection, *np.meshgrid(found.east, found.north))[1]
    np.testing.assert_allclose(found.depth, 1000.0 * (latitude + 40.6), atol=0.01)
