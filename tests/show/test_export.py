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
from replay_kit.show.export import export
from tests.core.flow.test_cf import PERSONAL, complaints, found_by
from tests.results.cases import placed, write
from tests.synthetic_flow import TIME_NS, synthetic_flow

__all__ = ["complaints"]
KML, GX = "{http://www.opengis.net/kml/2.2}", "{http://www.google.com/kml/ext/2.2}"
PLACES = [(5.0, 62.0, 10.0), (5.05, 62.01, 130.0)]
ROWS = {"series": 6, "track": 3, "section": 9, "dives": 3, "innovations": 12, "plans": 3}
NAMES = ["track", "begin", "last plan", "start", "vehicle", "goal, 100 m", "place 0", "place 1"]
TIMES = ["2023-11-14T22:13:20Z", "2023-11-14T23:13:20Z", "2023-11-15T00:13:20Z"]


@pytest.fixture
def contents(tmp_path, innovation, plan):
    innovations = [replace(innovation, dive=k + 1) for k in range(3)]
    return write(tmp_path / "r.mcap", synthetic_flow(), innovations, plan)


@pytest.fixture
def features(tmp_path):
    """Return a function that exports to GeoJSON and KML, and returns features and the root of the KML."""

    def make(contents, *args, **more):
        export(contents, tmp_path / "x.geojson", *args, **more)
        export(contents, tmp_path / "x.kml", *args, **more)
        found = json.loads((tmp_path / "x.geojson").read_text())["features"]
        return found, ElementTree.parse(tmp_path / "x.kml").getroot()

    return make


def texts(root, name):
    return [each.text for each in root.iter(name)]


@pytest.mark.full
def test_netcdf_holds_every_table_and_is_compliant(contents, tmp_path, complaints):
    rows = export(contents, tmp_path / "x.nc", PLACES)
    assert {name: count for name, count in rows.items() if count} == ROWS
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
        assert dict(found.sizes) == ROWS
        expected = contents.series(PLACES[1])
        np.testing.assert_array_equal(found["series_u"][3:], expected["u"])
        error = found["series_v_standard_error"][3:]
        np.testing.assert_array_equal(error, expected.v_standard_error)
        for name, key, value in (
            ("series_u", "standard_name", "eastward_sea_water_velocity"),
            ("section_v_measured", "standard_name", "northward_sea_water_velocity"),
            ("section_depth", "positive", "down"),
            ("innovations_innovation_std_east", "units", "m s-1"),
        ):
            assert found[name].attrs[key] == value
        total = found["section_u_estimated"] + found["section_u_residual"]
        np.testing.assert_allclose(found["section_u_measured"], total, rtol=1e-12)


def test_a_table_alone_has_the_names_of_along_in_netcdf_as_in_csv(contents, tmp_path):
    expected = contents.estimate.along(contents.result.fixes)
    export(contents, tmp_path / "x.nc", table="track")
    export(contents, tmp_path / "x.csv", table="track")
    table = pd.read_csv(tmp_path / "x.csv")
    with xr.open_dataset(tmp_path / "x.nc") as found:
        for name in ("u", "v", "u_standard_error", "v_standard_error", "depth"):
            np.testing.assert_array_equal(found[name], getattr(expected, name))
            np.testing.assert_allclose(table[name], found[name], rtol=1e-14)
            assert found[name].attrs["units"] == expected.to_xarray()[name].attrs["units"]
        assert {*found.coords} == {"time", "longitude", "latitude", "depth"}
        assert {*found.variables} == {*table} == {*expected.to_pandas()} | {"dead_reckoned"}


def test_csv_holds_one_table_whose_texts_are_no_formulas(contents, tmp_path, innovation, plan):
    path = tmp_path / "x.csv"
    assert export(contents, path) == {"track": 3}
    assert export(contents, path, PLACES) == {"series": 6}
    assert pd.read_csv(path)["place"].tolist() == [0, 0, 0, 1, 1, 1]
    odd = replace(plan, status="=HYPERLINK(1)")
    contents = write(tmp_path / "odd.mcap", synthetic_flow(), [innovation], odd)
    export(contents, path, table="plans")
    assert pd.read_csv(path)["status"].tolist() == ["'=HYPERLINK(1)"] * 3
    assert export(contents, path, table="innovations") == {"innovations": 4}
    # negative numbers stay numbers
    residual = contents.result.innovations["residual_east"].to_numpy()
    assert (residual < 0.0).any()
    np.testing.assert_allclose(pd.read_csv(path)["residual_east"], residual, rtol=1e-7)


def test_geojson_and_kml_hold_track_places_and_plan_in_the_same_colours(contents, features):
    found, root = features(contents, PLACES)
    assert [one["properties"]["name"] for one in found] == texts(root, f"{KML}name") == NAMES
    line = [[5.0, 62.0], [5.01, 62.002], [5.02, 62.004]]
    assert found[0]["geometry"] == {"type": "LineString", "coordinates": line}
    about = found[-1]["properties"]
    assert (about["v_m_s"], about["depth_m"]) == (contents.series(PLACES[1])["v"].iloc[-1], 130.0)
    track = next(root.iter(f"{GX}Track"))
    assert texts(track, f"{GX}coord") == [f"{x:.7f} {y:.7f} 0" for x, y in line]
    # a time for each place of the track, the same as in GeoJSON; one for each point
    assert texts(track, f"{KML}when") == found[0]["properties"]["coordTimes"] == TIMES
    # colours, of KML in its own order
    colours = {one["properties"]["role"]: one["properties"].get("stroke") for one in found}
    assert (colours["track"], colours["plan"]) == ("#1b2530", "#b8500f")
    assert texts(root, f"{KML}color")[:3:2] == ["ff30251b", "ff0f50b8"]


def test_across_the_antimeridian_lines_are_continuous_in_geojson_and_within_180_in_kml(
    tmp_path, innovation, features
):
    contents = write(tmp_path / "r.mcap", placed(179.99, 62.0), [innovation] * 3, None)
    (track, *_), root = features(contents, table="track")
    assert [x for x, _ in track["geometry"]["coordinates"]] == [179.99, 180.0, 180.01]
    places = [float(text.split()[0]) for text in texts(root, f"{GX}coord")]
    assert places == [179.99, -180.0, -179.99]


def test_surfacings_have_points_and_counter_clockwise_ellipses(tmp_path, innovation, features):
    predicted = Surfacing(TIME_NS, 5.0, 62.0, Ellipse(5.0, 62.0, 900.0, 300.0, 90.0))
    outcome = SurfacingOutcome(TIME_NS, predicted, TIME_NS, 5.01, 62.0, 12.5, 90.0)
    path, more = tmp_path / "r.mcap", lambda writer: writer.outcome(outcome)
    contents = write(path, synthetic_flow(), [innovation], None, more=more)
    found, root = features(contents, table="surfacings")
    ellipse, *_, actual = found
    assert len(found) == 4
    assert actual["geometry"]["coordinates"] == [5.01, 62.0]
    about = {"name": "surfacing, actual", "time": TIMES[0], "distance_m": 12.5}
    assert actual["properties"].items() >= about.items()
    assert texts(root, f"{KML}when") == TIMES[:1] * 3
    x, y = np.array(ellipse["geometry"]["coordinates"][0]).T
    assert np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]) > 0.0


@pytest.mark.parametrize(
    ("name", "table", "message"),
    [
        ("x.xls", None, r"ends in one of \.nc, \.csv, \.kml, \.geojson, got '\.xls'"),
        ("x.csv", "tracks", "expected one of series, track, .*, estimate, got 'tracks'"),
        ("x.csv", "series", "series: expected one or more places, got none"),
        ("x.kml", "section", r"ends in \.nc or \.csv for the table section, got \.kml"),
        ("x.csv", "estimate", r"ends in \.nc for the table estimate, got \.csv"),
    ],
)
def test_what_cannot_be_exported_is_refused(contents, tmp_path, name, table, message):
    with pytest.raises(ConfigError, match=message):
        export(contents, tmp_path / name, table=table)
    assert not (tmp_path / name).exists()
