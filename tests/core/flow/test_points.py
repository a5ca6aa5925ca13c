"""Velocities at places in degrees and along tracks."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from replay_kit.core.errors import ConfigError, EstimatorError
from replay_kit.core.flow.points import best_velocity_at
from replay_kit.core.geodesy import to_local
from tests.core.flow.made import HOUR, changing
from tests.synthetic_flow import TIME_NS

HERE = (5.03, 62.02, 40.0)
NAMES = ("u", "v", "u_standard_error", "v_standard_error")
LATER = TIME_NS + 3 * HOUR


def test_where_nothing_is_known_there_is_no_number_and_a_latitude_that_is_none_is_refused(flow):
    land = float(flow.grid.longitude[0, 0]), float(flow.grid.latitude[0, 0])
    longitude, latitude = [5.0, 9.0, land[0], 5.0, np.nan], [62.0, 62.0, land[1], *[62.0] * 2]
    got = flow.velocity_at(longitude, latitude, [10, 10, 10, 201, 10])
    for name in NAMES:
        assert np.isfinite(getattr(got, name)).tolist() == [True, *[False] * 4]
    assert "4 of 5 outside the region, on land or below the last level: NaN" in repr(got)
    without = flow.mean_flow().velocity_at(*HERE)
    assert [np.isfinite(getattr(without, name)) for name in NAMES] == [True, True, False, False]
    with pytest.raises(EstimatorError, match=r"expected -90 to 90 degrees, got 152\.6; the order"):
        flow.velocity_at(-40.0, 152.6, 10.0)
    assert np.isnan(flow.velocity_at(0.0, 90.0, 10.0).u)
    assert len(flow.to_pandas()) == flow.grid.wet.sum() < flow.grid.wet.size


def test_each_point_has_its_own_time_and_the_past_is_refused():
    flow, now = changing(), changing().at(LATER)
    here = *to_local(flow.grid.projection, *HERE[:2]), HERE[2]
    expected = [*now.velocity(*here, true_axes=True), *now.standard_error(*here, true_axes=True)]
    for time in ("2023-11-15T01:13:20.123456789Z", LATER):
        got = flow.velocity_at(*HERE, time)
        assert [getattr(got, name) for name in NAMES] == pytest.approx(expected, rel=1e-12)
        assert got.time == got.estimate_time == np.datetime64(LATER, "ns")
    times = TIME_NS + HOUR * np.array([5, 0, 5, 9])
    several = flow.velocity_at(*HERE, times).u.tolist()
    assert several == [flow.velocity_at(*HERE, time).u for time in times]
    assert len({*several}) == 3
    with pytest.raises(EstimatorError, match="is before the last observation of the estimate"):
        flow.velocity_at(*HERE, TIME_NS - 10**9)
    for wrong in (1.7e18, np.datetime64("NaT", "ns"), "yesterday", [TIME_NS, None], True):
        with pytest.raises(ConfigError, match="ISO 8601"):
            flow.velocity_at(*HERE, wrong)


def test_a_track_is_a_table_a_dataset_or_a_mapping(flow):
    alone, flow = flow.mean_flow(), changing()
    times = (TIME_NS + HOUR * np.array([-2, 1])).astype("datetime64[ns]")
    columns = {"longitude": [5.0, 5.02], "latitude": [62.0, 62.01], "depth": [5.0, 90.0]}
    expected = flow.velocity_at(5.0, 62.0, 5.0).u, flow.velocity_at(5.02, 62.01, 90.0, times[1]).u
    timed = {"time": times, **columns}
    table = pd.DataFrame(timed)
    for track in (table, table.set_index("time"), xr.Dataset.from_dataframe(table), timed):
        got = flow.along(track)
        assert got.u.tolist() == list(expected)
        assert got.time.tolist() == times.tolist()
        # the past of the last observation is not known to the estimate
        assert got.estimate_time.tolist() == [TIME_NS, TIME_NS + HOUR]
    assert flow.along(columns).time.tolist() == [TIME_NS, TIME_NS]
    assert flow.along(table[:0]).u.shape == (0,)
    # one without a model of time is as it is
    got = alone.along(timed)
    assert got.u.tolist() == alone.along(columns).u.tolist()
    assert (got.time.tolist(), {*got.estimate_time.tolist()}) == (times.tolist(), {TIME_NS})
    for call, words in (
        (lambda: flow.along([5.0, 62.0]), r"expected a table, dataset or mapping .*, got list"),
        (lambda: flow.along({"longitude": [5.0]}), "but latitude, depth is missing"),
        (lambda: alone.velocity_at(5.0, 62.0, 5.0, TIME_NS), "has no model of time"),
    ):
        with pytest.raises(EstimatorError, match=words):
            call()


def test_points_become_tables_and_datasets_and_short_texts(flow):
    got = flow.velocity_at([[5.0, 5.02]], 62.0, 10.0)
    table, dataset = got.to_pandas(), got.to_xarray()
    assert table.columns.tolist() == [*dataset.coords, *NAMES]
    assert table["u"].tolist() == got.u.ravel().tolist() == dataset["u"].values.tolist()
    assert (table["time"] == pd.Timestamp(TIME_NS)).all()
    one, many = flow.velocity_at(*HERE), changing().velocity_at(*HERE, [TIME_NS, TIME_NS + HOUR])
    assert isinstance(one.u, float)
    for value, text in (
        (one, "Velocity at 5.0300 E, 62.0200 N, 40 m deep, 2023-11-14 22:13:20Z\n"),
        (one, f"u {one.u:.3f} +- {one.u_standard_error:.3f}, v {one.v:.3f} +- "),
        (many, "2 points (2,), 40 m deep, 2023-11-14 22:13:20Z to 2023"),
        (replace(flow, time_ns=None).velocity_at(*HERE), "no time"),
        (changing(), "20Z (at(time) gives it for another time), 4 modes a level"),
        (flow.mean_flow(), "(no model of time), no uncertainty"),
        (flow.mean_flow().velocity_at(*HERE), f"u {one.u:.3f}, v {one.v:.3f} m/s"),
    ):
        assert text in repr(value)


@pytest.mark.parametrize("kind", ["hat", "gaussian"])
def test_a_grid_has_the_velocities_and_errors_of_its_points_at_each_time(kind):
    flow = changing(kind=kind)
    axes = {"longitude": [4.95, 5.0, 5.05], "latitude": [61.98, 62.02], "depth": [10.0, 60.0]}
    times = (TIME_NS + HOUR * np.array([1, 7])).astype("datetime64[ns]")
    dataset, one = (flow.to_xarray(**axes, time=each) for each in (times, times[1]))
    assert dataset["u"].dims == ("time", "depth", "latitude", "longitude")
    at = np.meshgrid(times, *reversed(axes.values()), indexing="ij")
    points = flow.velocity_at(*reversed(at[1:]), at[0])
    for name in NAMES:
        np.testing.assert_allclose(dataset[name], getattr(points, name), rtol=1e-9)
        np.testing.assert_array_equal(one[name], dataset[name][1])
    table = flow.to_pandas(**axes, time=times).set_index(["time", *one["u"].dims])["u"]
    assert table.size == 24
    assert table[times[1], 60.0, 62.02, 5.05] == one["u"][1, 1, 2]


def test_of_several_windows_the_surest_counts_and_of_equally_sure_ones_the_last(flow):
    for factors, chosen in (((1.0, 2.0), 0), ((1.0, 1.0), 1), ((1.0, 1.0, 2.0, 1.0, 1.5), 3)):
        windows = [
            replace(flow, unknowns=replace(flow.unknowns, scaled=factor), time_ns=TIME_NS + k)
            for k, factor in enumerate(factors)
        ]
        found, expected = best_velocity_at(windows, *HERE), windows[chosen].velocity_at(*HERE)
        for name in (*NAMES, "time", "estimate_time"):
            assert getattr(found, name) == getattr(expected, name)
        beyond = best_velocity_at(windows, [HERE[0], 9.0], *HERE[1:])
        assert np.isfinite(beyond.u).tolist() == [True, False]
