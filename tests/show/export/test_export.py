"""Exports: the numbers of a result in each form, CF attributes, and what is refused."""

import json
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from replay_kit.core.errors import ConfigError
from replay_kit.core.surfacing import Ellipse, Surfacing, SurfacingOutcome
from replay_kit.results.geojson import features_of
from replay_kit.show.export.export import export
from replay_kit.show.export.kml import kml_text
from replay_kit.show.export.netcdf import ATTRIBUTES, _attributes
from tests.core.flow.test_cf import PERSONAL, complaints, found_by
from tests.results.cases import placed, write
from tests.synthetic_flow import TIME_NS, synthetic_flow

__all__ = ["complaints"]
GX = "http://www.google.com/kml/ext/2.2"
PLACES = [(5.0, 62.0, 10.0), (5.05, 62.01, 130.0)]


@pytest.fixture
def contents(tmp_path, innovation, plan):
    innovations = [replace(innovation, dive=k + 1) for k in range(3)]
    return write(tmp_path / "r.mcap", synthetic_flow(), innovations, plan)


@pytest.mark.full
def test_netcdf_holds_every_table_and_is_compliant(contents, tmp_path, complaints):
    rows = export(contents, tmp_path / "x.nc", PLACES)
    assert rows == {
        "series": 6,
        "track": 3,
        "section": 9,
        "dives": 3,
        "innovations": 12,
        "surface": 0,
        "surfacings": 0,
        "plans": 3,
    }
    assert complaints(tmp_path / "x.nc") == []
    # of ACDD lack what only a person can state and the names of columns that CF has no name for; of several depths the checker reads one
    left = [
        each
        for each in found_by(tmp_path / "x.nc", "acdd:1.3", least=2)
        if not any(f"{name} " in each for name in PERSONAL)
    ]
    assert {each.split(" != ")[0] for each in left} <= {
        *("standard_name", "geospatial_vertical_min", "geospatial_vertical_max"),
        *(each for each in left if "variable to test extent" in each),
    }
    with xr.open_dataset(tmp_path / "x.nc") as found:
        assert dict(found.sizes) == {name: count for name, count in rows.items() if count}
        expected = contents.series(PLACES[1])
        np.testing.assert_array_equal(found["series_u"][3:], expected.u)
        np.testing.assert_array_equal(
            found["series_v_standard_error"][3:], expected.v_standard_error
        )
        assert found["series_depth"].values.tolist() == [10.0] * 3 + [130.0] * 3
        assert found["series_u"].attrs["standard_name"] == "eastward_sea_water_velocity"
        assert found["section_v_measured"].attrs["standard_name"] == "northward_sea_water_velocity"
        assert found["section_depth"].attrs["positive"] == "down"
        assert found["innovations_innovation_std_east"].attrs["units"] == "m s-1"
        assert (found.attrs["local_frame_longitude"], found.attrs["local_frame_latitude"]) == (
            5.0,
            62.0,
        )
        assert found["plans_status"].values.tolist() == [b"reached"] * 3
        times = found["track_time"].values.astype("datetime64[s]")
        np.testing.assert_array_equal(
            times, contents.result.fixes.index.to_numpy().astype("datetime64[s]")
        )
        total = found["section_u_estimated"] + found["section_u_residual"]
        np.testing.assert_allclose(found["section_u_measured"], total, rtol=1e-12)


def test_a_table_alone_has_the_names_of_along_in_netcdf_as_in_csv(contents, tmp_path):
    expected = contents.estimate.along(contents.result.fixes)
    export(contents, tmp_path / "x.nc", table="track")
    export(contents, tmp_path / "x.csv", table="track")
    with xr.open_dataset(tmp_path / "x.nc") as found:
        names = {*found.variables}
        for name in ("u", "v", "u_standard_error", "v_standard_error", "depth"):
            np.testing.assert_array_equal(found[name], getattr(expected, name))
            assert found[name].attrs["units"] == expected.to_xarray()[name].attrs["units"]
        assert {*found.coords} == {"time", "longitude", "latitude", "depth"}
    assert names == {*pd.read_csv(tmp_path / "x.csv")}
    assert names == {*expected.to_pandas()} | {"dead_reckoned"}


@pytest.mark.parametrize("end", ["longitude", "latitude", "depth"])
def test_columns_of_places_have_the_attributes_of_a_place_whatever_goes_before(end):
    alone, before = _attributes("surfacings", end), _attributes("surfacings", f"forecast_{end}")
    assert alone["standard_name"] == end
    assert before == alone | {"long_name": f"forecast {end} (surfacings)"}


def test_csv_holds_one_table(contents, tmp_path):
    assert export(contents, tmp_path / "a.csv", PLACES) == {"series": 6}
    assert export(contents, tmp_path / "b.csv") == {"track": 3}
    assert export(contents, tmp_path / "c.csv", table="innovations") == {"innovations": 12}
    track = pd.read_csv(tmp_path / "b.csv", parse_dates=["time"])
    expected = contents.estimate.along(contents.result.fixes)
    np.testing.assert_allclose(track["u"], expected.u, rtol=1e-14)
    np.testing.assert_array_equal(track["longitude"], contents.result.fixes["longitude"])
    assert (tmp_path / "a.csv").read_text().splitlines()[
        0
    ] == "place,time,longitude,latitude,depth,u,v,u_standard_error,v_standard_error"
    assert pd.read_csv(tmp_path / "a.csv")["place"].tolist() == [0, 0, 0, 1, 1, 1]


def test_a_text_is_no_formula_in_csv(tmp_path, innovation, plan):
    contents = write(
        tmp_path / "r.mcap", synthetic_flow(), [innovation], replace(plan, status="=HYPERLINK(1)")
    )
    export(contents, tmp_path / "plans.csv", table="plans")
    assert pd.read_csv(tmp_path / "plans.csv")["status"].tolist() == ["'=HYPERLINK(1)"] * 3
    export(contents, tmp_path / "innovations.csv", table="innovations")
    # negative numbers stay numbers
    residual = contents.result.innovations["residual_east"].to_numpy()
    assert (residual < 0.0).any()
    np.testing.assert_allclose(
        pd.read_csv(tmp_path / "innovations.csv")["residual_east"], residual, rtol=1e-7
    )


def test_without_an_estimate_the_track_has_positions_alone(tmp_path, innovation):
    contents = write(tmp_path / "r.mcap", synthetic_flow(), [innovation], None, estimate=False)
    export(contents, tmp_path / "x.csv")
    assert (tmp_path / "x.csv").read_text().splitlines()[
        0
    ] == "time,longitude,latitude,depth,dead_reckoned"
    assert export(contents, tmp_path / "x.nc")["plans"] == 0


NAMES = ["track", "begin", "last plan", "start", "vehicle", "goal, 100 m", "place 0", "place 1"]


def test_geojson_and_kml_hold_track_places_and_plan(contents, tmp_path):
    export(contents, tmp_path / "x.geojson", PLACES)
    features = json.loads((tmp_path / "x.geojson").read_text())["features"]
    assert [feature["properties"]["name"] for feature in features] == NAMES
    assert features[0]["geometry"] == {
        "type": "LineString",
        "coordinates": [[5.0, 62.0], [5.01, 62.002], [5.02, 62.004]],
    }
    last = contents.series(PLACES[1])
    assert features[-1]["properties"]["v_m_s"] == last.v[-1]
    assert features[-1]["properties"]["depth_m"] == 130.0
    export(contents, tmp_path / "x.kml", PLACES)
    root = ElementTree.parse(tmp_path / "x.kml").getroot()
    space = "{http://www.opengis.net/kml/2.2}"
    assert [name.text for name in root.iter(f"{space}name")] == NAMES
    track = next(root.iter(f"{{{GX}}}Track"))
    assert [place.text for place in track.iter(f"{{{GX}}}coord")] == [
        "5.0000000 62.0000000 0",
        "5.0100000 62.0020000 0",
        "5.0200000 62.0040000 0",
    ]
    # a time for each place of the track, the same as in GeoJSON; one for each point
    times = ["2023-11-14T22:13:20Z", "2023-11-14T23:13:20Z", "2023-11-15T00:13:20Z"]
    assert [when.text for when in track.iter(f"{space}when")] == times
    assert features[0]["properties"]["coordTimes"] == times
    assert len(list(root.iter(f"{space}TimeStamp"))) == 6


def test_features_are_styled_for_maps_and_kml_has_the_same_colours_in_its_own_order(
    contents, tmp_path
):
    export(contents, tmp_path / "x.geojson", PLACES)
    export(contents, tmp_path / "x.kml", PLACES)
    features = json.loads((tmp_path / "x.geojson").read_text())["features"]
    styles = {one["properties"]["role"]: one["properties"] for one in features}
    assert styles["track"]["stroke"] == styles["vehicle"]["marker-color"] == "#1b2530"
    assert styles["plan"]["stroke"] == styles["goal"]["marker-color"] == "#b8500f"
    assert styles["place"]["marker-color"] == "#5b6b78"
    root = ElementTree.parse(tmp_path / "x.kml").getroot()
    colors = [color.text for color in root.iter("{http://www.opengis.net/kml/2.2}color")]
    assert colors[::2] == ["ff30251b", "ff0f50b8", "ff30251b", "ff786b5b"]


def test_across_the_antimeridian_lines_are_continuous_in_geojson_and_within_180_in_kml(
    tmp_path, innovation
):
    contents = write(tmp_path / "r.mcap", placed(179.99, 62.0), [innovation] * 3, None)
    export(contents, tmp_path / "x.geojson", table="track")
    export(contents, tmp_path / "x.kml", table="track")
    track, *_ = json.loads((tmp_path / "x.geojson").read_text())["features"]
    assert [point[0] for point in track["geometry"]["coordinates"]] == [179.99, 180.0, 180.01]
    places = [
        place.text
        for place in ElementTree.parse(tmp_path / "x.kml").getroot().iter(f"{{{GX}}}coord")
    ]
    assert places == [
        "179.9900000 62.0000000 0",
        "-180.0000000 62.0020000 0",
        "-179.9900000 62.0040000 0",
    ]


def test_surfacings_have_points_and_counter_clockwise_ellipses(tmp_path, innovation):
    ellipse = Ellipse(5.0, 62.0, 900.0, 300.0, 90.0)
    predicted = Surfacing(TIME_NS, 5.0, 62.0, ellipse)
    outcome = SurfacingOutcome(TIME_NS, predicted, TIME_NS, 5.01, 62.0, 12.5, 90.0)

    def surface(writer):
        writer.outcome(outcome)

    contents = write(tmp_path / "r.mcap", synthetic_flow(), [innovation], None, more=surface)
    export(contents, tmp_path / "x.geojson", table="surfacings")
    found = json.loads((tmp_path / "x.geojson").read_text())["features"]
    names = ["90 % ellipse of a surfacing", "surfacing, apart"]
    names += ["surfacing, predicted", "surfacing, actual"]
    assert [one["properties"]["name"] for one in found] == names
    assert found[3]["geometry"]["coordinates"] == [5.01, 62.0]
    time = "2023-11-14T22:13:20Z"
    about = {"name": "surfacing, actual", "time": time, "distance_m": 12.5}
    assert found[3]["properties"].items() >= about.items()
    kml = kml_text(features_of(contents))
    assert kml.count(f"<TimeStamp><when>{time}</when></TimeStamp>") == 4
    assert "<PolyStyle><color>260f50b8</color></PolyStyle>" in kml
    x, y = np.array(found[0]["geometry"]["coordinates"][0]).T
    assert np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]) > 0.0


@pytest.mark.parametrize(
    ("name", "table", "message"),
    [
        (
            "x.xls",
            None,
            r"expected a name that ends in one of \.nc, \.csv, \.kml, \.geojson, got '\.xls'",
        ),
        (
            "x.csv",
            "tracks",
            "expected one of series, track, section, dives, innovations, surface, surfacings, plans, estimate, got 'tracks'",
        ),
        ("x.csv", "series", "series: expected one or more places, got none"),
        (
            "x.kml",
            "section",
            r"expected one of series, track, surfacings, plans in \.kml, got 'section'",
        ),
    ],
)
def test_what_cannot_be_exported_is_refused(contents, tmp_path, name, table, message):
    with pytest.raises(ConfigError, match=message):
        export(contents, tmp_path / name, table=table)
    assert not (tmp_path / name).exists()


@pytest.mark.parametrize("column", sorted(ATTRIBUTES.keys() - {"estimate_time"}))
def test_columns_that_other_files_hold_too_have_their_attributes(column):
    found, expected = _attributes("fixes", column), ATTRIBUTES[column]
    assert {key: found[key] for key in expected if key != "long_name"} == {
        key: value for key, value in expected.items() if key != "long_name"
    }
