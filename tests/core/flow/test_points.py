"""Velocities at places in degrees and along tracks."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from replay_kit.core.errors import ConfigError, EstimatorError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.evolution import constant
from replay_kit.core.geodesy import rotate_to_geographic, to_geographic, to_local
from tests.core.flow.test_evolution import HOUR, evolving
from tests.synthetic_flow import TIME_NS

HERE = (5.03, 62.02, 40.0)


def test_a_point_has_the_velocity_and_error_of_its_place_on_true_axes(make_flow):
    flow = make_flow(spacing=150_000.0)
    east, north = np.array([-4e5, 3e5]), np.array([2.5e5, -2e5])
    longitude, latitude = to_geographic(flow.grid.projection, east, north)
    got = flow.velocity_at(longitude, latitude, 60.0)
    u, v = rotate_to_geographic(
        flow.grid.projection, longitude, latitude, *flow.velocity(east, north, 60.0).T
    )
    np.testing.assert_allclose([got.u, got.v], [u, v], rtol=1e-9)
    assert np.abs(got.v - flow.velocity(east, north, 60.0)[:, 1]).max() > 0.01
    # its twin: a factor of the covariance is a sum of flows, each with velocities on true axes
    squares = np.zeros((2, 2))
    for column in np.linalg.cholesky(flow.weight_cov).T:
        part = replace(flow.mean_flow(), latent=flow.modes @ column.reshape(3, 4).T).velocity_at(
            longitude, latitude, 60.0
        )
        squares += np.array([part.u, part.v]) ** 2
    np.testing.assert_allclose(
        [got.u_standard_error, got.v_standard_error], np.sqrt(squares), rtol=1e-9
    )


def test_shapes_broadcast_and_one_point_gives_numbers(flow):
    grid = flow.velocity_at([[5.0], [5.05]], 62.0, [0.5, 40.0, 150.0])
    assert grid.u.shape == grid.depth.shape == grid.time.shape == (2, 3)
    one = flow.velocity_at(5.05, 62.0, 40.0)
    assert isinstance(one.u, float)
    assert one.u == pytest.approx(grid.u[1, 1], rel=1e-12)
    assert one.time == one.estimate_time == np.datetime64(TIME_NS, "ns")
    # any turn of longitude is the same place
    assert flow.velocity_at(5.05 - 360.0, 62.0, 40.0).u == pytest.approx(one.u, rel=1e-9)


def test_where_nothing_is_known_there_is_no_number(flow):
    grid = flow.grid
    land = float(grid.longitude[0, 0]), float(grid.latitude[0, 0])
    got = flow.velocity_at(
        [5.0, 9.0, land[0], 5.0, np.nan, 5.0],
        [62.0, 62.0, land[1], 62.0, 62.0, 62.0],
        [10, 10, 10, 201, 10, np.nan],
    )
    for values in (got.u, got.v, got.u_standard_error, got.v_standard_error):
        assert np.isfinite(values).tolist() == [True, False, False, False, False, False]
    assert "5 of 6 outside the region, on land or below the last level: NaN" in repr(got)
    without = flow.mean_flow().velocity_at(*HERE)
    assert np.isfinite(without.u)
    assert np.isnan([without.u_standard_error, without.v_standard_error]).all()


def test_a_latitude_that_is_none_is_refused(flow):
    with pytest.raises(
        EstimatorError,
        match=r"expected -90 to 90 degrees, got 152\.6; the order is longitude, latitude, depth",
    ):
        flow.velocity_at(-40.0, 152.6, 10.0)
    assert np.isnan(flow.velocity_at(0.0, 90.0, 10.0).u)


@pytest.mark.parametrize(
    "time",
    [
        "2023-11-15T01:13:20.123456789Z",
        np.datetime64(TIME_NS + 3 * HOUR, "ns"),
        TIME_NS + 3 * HOUR,
        pd.Timestamp(TIME_NS + 3 * HOUR, tz="Europe/Oslo"),
    ],
)
def test_a_time_is_text_a_date_or_nanoseconds(time):
    flow = evolving()
    got, now = flow.velocity_at(*HERE, time), flow.at(TIME_NS + 3 * HOUR)
    east, north = to_local(flow.grid.projection, *HERE[:2])
    expected = now.velocity(east, north, HERE[2], true_axes=True)
    assert [got.u, got.v] == pytest.approx(expected, rel=1e-12)
    assert [got.u_standard_error, got.v_standard_error] == pytest.approx(
        now.standard_error(east, north, 40.0, true_axes=True), rel=1e-12
    )
    assert got.time == got.estimate_time == np.datetime64(TIME_NS + 3 * HOUR, "ns")


def test_each_point_has_its_own_time():
    flow = evolving()
    hours = np.array([5, 0, 5, 9])
    got = flow.velocity_at(*HERE, TIME_NS + HOUR * hours)
    assert got.u.tolist() == [
        flow.velocity_at(*HERE, TIME_NS + HOUR * int(hour)).u for hour in hours
    ]
    assert len(set(got.u.tolist())) == 3


def test_a_time_before_the_last_observation_is_refused():
    with pytest.raises(
        EstimatorError,
        match=r"2023-11-14 22:13:19Z is before the last observation of the estimate, 2023-11-14 22:13:20Z",
    ):
        evolving().velocity_at(*HERE, TIME_NS - 10**9)


@pytest.mark.parametrize(
    "time", [1.7e18, np.datetime64("NaT", "ns"), "yesterday", [TIME_NS, None], True]
)
def test_other_times_are_refused(flow, time):
    with pytest.raises(ConfigError, match="ISO 8601"):
        replace(flow, later=constant).velocity_at(*HERE, time)


def test_a_track_is_a_table_a_dataset_or_a_mapping():
    flow = evolving()
    times = (TIME_NS + HOUR * np.array([-2, 1])).astype("datetime64[ns]")
    columns = {"longitude": [5.0, 5.02], "latitude": [62.0, 62.01], "depth": [5.0, 90.0]}
    expected = flow.velocity_at(5.0, 62.0, 5.0).u, flow.velocity_at(5.02, 62.01, 90.0, times[1]).u
    table = pd.DataFrame({"time": times, **columns})
    for track in (
        table,
        table.set_index("time"),
        xr.Dataset.from_dataframe(table),
        {"time": times, **columns},
    ):
        got = flow.along(track)
        assert got.u.tolist() == list(expected)
        assert got.time.tolist() == times.tolist()
        # the past of the last observation is not known to the estimate
        assert got.estimate_time.tolist() == [TIME_NS, TIME_NS + HOUR]
    assert flow.along(columns).time.tolist() == [TIME_NS, TIME_NS]
    assert flow.along(table[:0]).u.shape == (0,)


def test_what_is_no_track_is_refused(flow):
    with pytest.raises(
        EstimatorError,
        match=r"expected a table, dataset or mapping with longitude.* and perhaps time, got list",
    ):
        flow.along([5.0, 62.0])
    with pytest.raises(EstimatorError, match="but latitude, depth is missing"):
        flow.along({"longitude": [5.0]})


def test_a_flow_without_a_model_of_time_is_as_it_is_along_a_track_and_refused_at_a_time(
    flow,
):
    got = flow.along(
        {
            "longitude": [5.0, 5.0],
            "latitude": 62.0,
            "depth": 5.0,
            "time": [TIME_NS - HOUR, TIME_NS + HOUR],
        }
    )
    assert got.u.tolist() == [flow.velocity_at(5.0, 62.0, 5.0).u] * 2
    assert got.time.tolist() == [TIME_NS - HOUR, TIME_NS + HOUR]
    assert got.estimate_time.tolist() == [TIME_NS, TIME_NS]
    with pytest.raises(EstimatorError, match="has no model of time"):
        flow.velocity_at(5.0, 62.0, 5.0, TIME_NS)


def test_a_track_of_the_past_is_one_evaluation(monkeypatch):
    flow, asked = evolving(), []
    at = FlowEstimate.at
    monkeypatch.setattr(
        FlowEstimate, "at", lambda self, time_ns: (asked.append(time_ns), at(self, time_ns))[1]
    )
    flow.along(
        {
            "longitude": 5.0,
            "latitude": 62.0,
            "depth": 5.0,
            "time": TIME_NS + HOUR * np.array([-3, -2, -1, 0, 1, 2, 2]),
        }
    )
    assert asked == [TIME_NS, TIME_NS + HOUR, TIME_NS + 2 * HOUR]


def test_points_become_tables_and_datasets(flow):
    got = flow.velocity_at([[5.0, 5.02]], 62.0, 10.0)
    table, dataset = got.to_pandas(), got.to_xarray()
    assert table.columns.tolist() == [
        *dataset.coords,
        "u",
        "v",
        "u_standard_error",
        "v_standard_error",
    ]
    assert table["u"].tolist() == got.u.ravel().tolist() == dataset["u"].values.tolist()
    assert dataset["u"].dims == ("point",)
    assert (
        dataset["v_standard_error"].attrs["standard_name"]
        == "northward_sea_water_velocity standard_error"
    )
    assert (table["time"] == pd.Timestamp(TIME_NS)).all()


def test_texts_are_short_and_have_units(flow):
    one = flow.velocity_at(*HERE)
    assert repr(one).splitlines() == [
        "Velocity at 5.0300 E, 62.0200 N, 40 m deep, 2023-11-14 22:13:20Z",
        f"  u {one.u:.3f} +- {one.u_standard_error:.3f}, v {one.v:.3f} +- {one.v_standard_error:.3f} m/s (true east, true north)",
    ]
    many = repr(
        evolving().velocity_at([5.0, 5.0], 62.0, [10.0, 20.0], TIME_NS + HOUR * np.array([0, 1]))
    )
    assert many.startswith(
        "Velocities at 2 points (2,), 10..20 m deep, 2023-11-14 22:13:20Z to 2023-11-14 23:13:20Z\n  u "
    )
    assert "no time" in repr(replace(flow, time_ns=None).velocity_at(*HERE))
    assert repr(flow).startswith(
        "FlowEstimate for 2023-11-14 22:13:20Z (no model of time), 4 modes a level\n  Grid of 3 levels x 5 x 7 points"
    )
    assert "(at(time) gives it for another time)" in repr(evolving())
    assert "no uncertainty" in repr(flow.mean_flow())


def test_a_grid_at_several_times_has_time_as_an_axis():
    flow = evolving()
    axes = {"longitude": [4.95, 5.0, 5.05], "latitude": [61.98, 62.02], "depth": [10.0, 60.0]}
    times = (TIME_NS + HOUR * np.array([1, 7])).astype("datetime64[ns]")
    dataset = flow.to_xarray(**axes, time=times)
    assert dataset["u"].dims == ("time", "depth", "latitude", "longitude")
    chosen = dataset.sel(time=times[1], depth=60.0, latitude=62.02, longitude=5.05)
    expected = flow.velocity_at(5.05, 62.02, 60.0, times[1])
    assert float(chosen["u"]) == pytest.approx(expected.u, rel=1e-9)
    assert float(chosen["v_standard_error"]) == pytest.approx(expected.v_standard_error, rel=1e-9)
    one = flow.to_xarray(**axes, time=times[1])
    assert one["u"].dims == ("depth", "latitude", "longitude")
    np.testing.assert_array_equal(one["u"], dataset["u"][1])
    table = flow.to_pandas(**axes, time=times)
    assert len(table) == 24
    assert table.set_index(["time", "depth", "latitude", "longitude"])["u"][
        times[1], 60.0, 62.02, 5.05
    ] == float(chosen["u"])


def test_a_table_leaves_out_what_is_not_known(flow):
    assert len(flow.to_pandas()) == flow.grid.wet.sum() < flow.grid.wet.size
