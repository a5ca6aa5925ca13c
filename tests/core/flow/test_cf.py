"""The NetCDF files against the IOOS compliance checker, with the table of standard names that it ships."""

import warnings
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr

with warnings.catch_warnings():
    # of the checker's own dependencies
    warnings.simplefilter("ignore")
    from compliance_checker.suite import CheckSuite

from replay_kit.core.errors import EstimatorError
from replay_kit.core.flow.dataset import write_grid
from replay_kit.core.flow.file import load
from replay_kit.studies.twins.ensemble import write_ensemble
from tests.synthetic_flow import regular
from tests.workflows.planning.test_currents import evolving


def found_by(path: Path, checker: str = "cf:1.11", least: int = 1, at_least: int = 21) -> list[str]:
    """Return what a checker of many groups finds wrong, of weights of at least 1 (suggested), 2 (recommended) or 3 (required)."""
    CheckSuite.load_all_available_checkers()
    suite = CheckSuite()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        dataset = suite.load_dataset(str(path))
        groups, failed = suite.run_all(dataset, [checker])[checker]
        points = getattr(dataset, "featureType", "") == "point"
        dataset.close()
    # it looks for the table of contiguous rows in any file that states its feature type
    assert set(failed) <= ({"check_domain_variables"} if points else set())
    assert len(groups) >= at_least
    return [
        message for group in groups if (group.weight or 3) >= least for message in messages(group)
    ]


@pytest.fixture(scope="module")
def complaints():
    """Return a function that gives what the checker finds wrong in a file; exports are checked by it too."""
    return found_by


def messages(result):
    """Return what a check that did not pass says; one that passed may say how."""
    passed, total = (
        result.value if isinstance(result.value, tuple) else (int(bool(result.value)), 1)
    )
    own = result.msgs if passed < total and not result.children else []
    return [*own, *(message for child in result.children for message in messages(child))]


TRACK = {"longitude": [5.0, 5.1], "latitude": [62.0, 62.05], "depth": [10.0, 500.0]}
TIMES = {"time": np.array(["2023-11-15T00:00:00.5", "2023-11-15T06:00:00.123456789"], "M8[ns]")}
AXES = [4.9, 5.0], [62.0, 62.05], [10.0, 100.0]
DATASETS = {
    "without uncertainty and time": lambda flow: replace(
        flow.mean_flow(), time_ns=None
    ).to_xarray(),
    "axes": lambda flow: flow.to_xarray(*AXES),
    "a part": lambda flow: flow.to_xarray().sel(latitude=62.0, method="nearest").isel(depth=0),
    "along a track": lambda flow: flow.along(TRACK | TIMES).to_xarray(),
    "along a track, no time known": lambda flow: (
        replace(flow, time_ns=None).along(TRACK).to_xarray()
    ),
    "one point": lambda flow: flow.velocity_at(5.0, 62.0, 10.0).to_xarray(),
    "two times": lambda _: evolving().to_xarray(
        *AXES, time=[evolving().time_ns, evolving().time_ns + 3600 * 10**9]
    ),
}


@pytest.mark.parametrize("name", DATASETS)
def test_a_dataset_of_the_library_is_compliant_when_xarray_writes_it(flow, tmp_path, name):
    dataset = DATASETS[name](regular(flow))
    dataset.to_netcdf(tmp_path / "dataset.nc", engine="h5netcdf")
    assert found_by(tmp_path / "dataset.nc") == []
    with xr.open_dataset(tmp_path / "dataset.nc", engine="h5netcdf") as written:
        assert set(written.variables) == set(dataset.variables)
        for each in dataset.variables:
            if dataset[each].dtype.kind == "M":
                apart = np.abs(written[each].values - dataset[each].values)
                np.testing.assert_array_equal(np.isnat(apart), np.isnat(dataset[each].values))
                assert not (apart > np.timedelta64(1, "us")).any()
            else:
                np.testing.assert_array_equal(written[each].values, dataset[each].values)


@pytest.mark.parametrize(("n_modes", "time_ns"), [(0, None), (4, 1_700_000_000_123_456_789)])
def test_files_are_compliant(make_flow, tmp_path, n_modes, time_ns):
    flow = replace(make_flow(n_modes=n_modes), time_ns=time_ns)
    write_grid(regular(flow), tmp_path / "grid.nc")
    flow.save(tmp_path / "flow.nc")
    assert found_by(tmp_path / "grid.nc") == found_by(tmp_path / "flow.nc") == []
    assert found_by(tmp_path / "flow.nc", "cf:1.8") == []


def test_files_of_a_synthetic_ensemble_are_compliant(tmp_path):
    write_ensemble(tmp_path / "ensemble.nc", tmp_path / "truth.nc", n_members=2)
    assert found_by(tmp_path / "ensemble.nc") == found_by(tmp_path / "truth.nc") == []


def test_a_curvilinear_grid_is_compliant_but_for_the_names_of_its_dimensions(make_flow, tmp_path):
    """CF recommends depth before the two dimensions of a curvilinear grid; the checker takes them for other ones."""
    write_grid(make_flow(), tmp_path / "grid.nc")
    found = found_by(tmp_path / "grid.nc")
    assert len(found) == 4
    assert all("depth (Z), y (A), x (A)" in message for message in found)


def test_a_box_across_the_antimeridian_begins_in_the_west(flow):
    about = flow.velocity_at([-179.9, 180.0, 179.9], 62.0, 10.0).to_xarray().attrs
    assert (about["geospatial_lon_min"], about["geospatial_lon_max"]) == (179.9, -179.9)
    assert about["geospatial_bounds"].startswith("POLYGON ((62.0 179.9, 62.0 179.9, 62.0 180.1,")


@pytest.mark.full
def test_a_saved_estimate_that_changes_with_time_is_compliant(tmp_path):
    evolving().save(tmp_path / "flow.nc")
    assert found_by(tmp_path / "flow.nc") == []


#: What only a person knows of a data set, of what ACDD requires and recommends.
PERSONAL = (
    *("acknowledgement", "comment", "creator_email", "creator_name", "creator_url"),
    *("date_created", "id", "institution", "license", "naming_authority", "project"),
    *("publisher_email", "publisher_name", "publisher_url"),
)


@pytest.mark.parametrize("name", ["grid", "points", "saved"])
def test_acdd_lacks_what_only_a_person_can_state(make_flow, tmp_path, name):
    flow, path = regular(make_flow()), tmp_path / "flow.nc"

    def written(flow):
        if name == "grid":
            write_grid(flow, path)
        elif name == "points":
            flow.along(TRACK | TIMES).to_xarray().to_netcdf(path, engine="h5netcdf")
        else:
            flow.save(path)
        return found_by(path, "acdd:1.3", least=2)

    lacking = " ".join(written(flow))
    assert all(f"{name} " in lacking for name in PERSONAL)
    stated = replace(
        flow, about={key: f"{key}-of-a-person" for key in PERSONAL} | {"date_created": "2026-01-01"}
    )
    # arrays without a name in the table of CF, as the weights of modes
    allowed = {"standard_name", "units"} if name == "saved" else set()
    left = [each for each in written(stated) if "variable to test extent" not in each]
    assert set(left) <= allowed
    if name == "saved":
        assert load(path).about == stated.about


#: What only a person knows of a glider's mission, of what OG1.0 asks.
MISSION = (
    *("contributor_name", "contributor_email", "contributor_role", "contributor_role_vocabulary"),
    *("contributing_institutions", "contributing_institutions_role"),
    *("contributing_institutions_role_vocabulary", "WMO_IDENTIFIER", "PLATFORM_MODEL"),
)


def og1():
    """Velocities along a track of two hours, which an estimate through time dates."""
    flow = evolving()
    times = np.datetime64(flow.time_ns, "ns") + np.array([0, 3600], "m8[s]")
    return flow.along(TRACK | {"time": times})


def test_a_track_of_og1_is_named_by_platform_and_start_and_needs_times():
    track = og1()
    made = track.to_og1("sg033", WMO_IDENTIFIER="7801")
    np.testing.assert_array_equal(made["U"], track.u)
    np.testing.assert_array_equal(made["LATITUDE"], track.latitude)
    assert str(made["TRAJECTORY"].values) == "sg033_20260101T120000"
    assert str(made["WMO_IDENTIFIER"].values) == "7801"
    flow = replace(evolving(), unknowns=None, time_ns=None)
    with pytest.raises(EstimatorError, match="all have a time"):
        flow.along(TRACK).to_og1("sg033")


@pytest.mark.full
def test_a_track_of_og1_lacks_terms_of_its_vocabulary_for_estimates_alone(tmp_path, monkeypatch):
    """The checker asks the vocabulary's server for all terms; here it is told those that the manual and its examples name."""
    terms = ("TIME", "LON", "LAT", "DEPTH", "LON_GPS", "LAT_GPS")
    graph = [{"@id": f"http://vocab.nerc.ac.uk/collection/OG1/current/{term}/"} for term in terms]
    answer = SimpleNamespace(json=lambda: {"@graph": [*graph, {}]})
    monkeypatch.setattr("requests.get", lambda url: answer)
    track, path = og1(), tmp_path / "track.nc"

    def found(**stated):
        track.to_og1("sg033", **stated).to_netcdf(path, engine="h5netcdf")
        assert found_by(path, "cf:1.8") == found_by(path) == []
        return found_by(path, "og:1.0", at_least=7)

    lacking = " ".join(found())
    assert all(f"{name} is missing" in lacking for name in (*MISSION, "date_created"))
    stated = dict.fromkeys(MISSION, "of a person") | {"date_created": "20260101T000000"}
    left = {message.split()[1] for message in found(**stated) if "'vocabulary'" in message}
    assert left == {"ESTIMATE_TIME", "U", "V", "U_STANDARD_ERROR", "V_STANDARD_ERROR"}
