"""Gliders' files through the commands: mean currents, a flight model that errs, and what is said of lost pings."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import replay_kit as rk
from replay_kit.core.as_flown import AsFlown
from replay_kit.core.geodesy import rotate_to_local
from replay_kit.core.message import LogReport, Message
from replay_kit.logs import merge
from replay_kit.logs.mcap.writer import write_mcap_log
from replay_kit.workflows.replay.account import Account
from replay_kit.workflows.replay.steps import Counts
from tests import synthetic
from tests.command import invoke, succeed
from tests.logs.netcdf import glider_samples as made
from tests.measurements.samples import fix, ping
from tests.places import DATA, needs
from tests.results.result_samples import metadata_of
from tests.show.report.html_of import figures
from tests.workflows.replay.test_flight_bias import dive

PRIOR = "[estimator]\nsample_share = 0.5\nshift_distance = 0.0\n"


@pytest.fixture(scope="module")
def ocean(tmp_path_factory):
    folder = tmp_path_factory.mktemp("ocean")
    forecast = synthetic.dataset(seed=4, n_members=12, shape=(5, 5))
    forecast.to_netcdf(folder / "E.nc", engine="h5netcdf")
    return folder


def line(ocean, logs, more=""):
    """A replay on an ensemble that is moved to the logs, with more settings."""
    (ocean / "run.toml").write_text(PRIOR + more)
    files = f"{logs} --ensemble {ocean}/E.nc --config {ocean}/run.toml -o {ocean}/out.mcap"
    return f"replay {files} --modes 20 --place-ensemble --overwrite"


def replayed(ocean, logs, more=""):
    return json.loads(succeed(f"{line(ocean, logs, more)} --json -").stdout)


def test_mean_currents_alone_estimate_a_field_and_say_so(ocean, tmp_path):
    answer = replayed(ocean, made.bodc(tmp_path / "a.nc"))
    assert answer["observations"]["used"] == 2
    notes = "\n".join(answer["notes"])
    assert "the estimate is based on 2 mean currents of dives only;" in notes
    assert "not a forecast" in notes
    assert answer["rms_innovation"]["after"] < answer["rms_innovation"]["prior"]


def test_what_was_assumed_is_kept_in_the_result(ocean, tmp_path):
    made.gliderdac(tmp_path / "profiles")
    replayed(ocean, tmp_path / "profiles")
    (kept,) = metadata_of(ocean / "out.mcap")["replay_kit.reading"].values()
    assert "mean current: 2 in 118 values, each counted once" in kept


def test_absolute_profiles_are_used_directly_and_after_conversion(ocean, tmp_path):
    path = made.spray(tmp_path / "a.nc")
    answer = replayed(ocean, path)
    assert (answer["observations"]["used"], answer["observations"]["bins_used"]) == (2, 19)
    succeed(f"convert {path} -o {tmp_path}/a.mcap")
    again = replayed(ocean, tmp_path / "a.mcap")
    assert again["rms_innovation"] == answer["rms_innovation"]


def surfaced(path, reference, last_fix=4500.0):
    """Ten pings of which the first is at a fix, and the others up to 3600 s later at the surface."""
    said = {"reference": reference, "velocity": [[0.1, 0.2, 0.0]] * 3}
    pings = [ping(t, **said) for t in np.linspace(1.0, 3600.0, 10)]
    fixes = [fix(t, 152.0 + 1e-5 * t) for t in (0.0, last_fix)]
    write_mcap_log(path, sorted([*fixes, *pings], key=lambda message: message.time_ns))
    return path


def test_a_summary_begins_with_the_pings_that_a_setting_would_keep(ocean, tmp_path):
    log = surfaced(tmp_path / "a.mcap", "earth")
    done = succeed(f"{line(ocean, log)} --json -")
    # of ten pings two are within 600 s of the first fix, and none of the last
    lost = "8 of 10 pings on /adcp were not used: no position"
    assert done.stderr.startswith(f"WITH CARE  {lost}")
    told = f"{lost} within 600 s; a larger measurements.position_max_age"
    assert json.loads(done.stdout)["lost_pings"].startswith(told)
    answer = replayed(ocean, log, "[measurements]\nposition_max_age = 4000.0\n")
    assert (answer["lost_pings"], answer["observations"]["used"]) == ("", 10)


def test_an_unknown_reference_ends_with_the_line_to_set(ocean, tmp_path):
    done = invoke(line(ocean, surfaced(tmp_path / "a.mcap", None)))
    assert done.exit_code == 3
    for words in ("10 of 10 pings on /adcp were not used", 'measurements.reference = "earth" or'):
        assert words in done.output


@needs(DATA / "glider")
@pytest.mark.parametrize(
    ("name", "read", "used"),
    [
        pytest.param("seagliderOG1_sg033_delayed.nc", 18, 18, marks=pytest.mark.full),
        # five are of times without a sample below 8 cm
        ("og1_sp028_20230202T1637_R.nc", 9, 4),
    ],
)
def test_mean_currents_of_real_files_are_used(ocean, name, read, used):
    answer = replayed(ocean, DATA / "glider" / name)
    (dac,) = (row for row in answer["messages"] if row["topic"] == "/dac")
    assert (dac["read"], dac["used"]) == (read, used)
    assert answer["observations"]["used"] + answer["observations"]["rejected"] == used


@needs(DATA / "seaglider")
def test_a_result_keeps_the_declination_and_a_plan_the_radius_of_the_log(ocean):
    """The last dive's: the radius was 2000 m before."""
    replayed(ocean, " ".join(f"{DATA}/seaglider/p171010{dive}.nc" for dive in (3, 4)))
    # the file has it in single precision
    assert AsFlown.in_metadata(metadata_of(ocean / "out.mcap")).declination == pytest.approx(
        -1.2, abs=1e-6
    )
    places = "--start 85.91,12.13,0 --goal 85.95,12.13,0 --samples 3 --json -"
    plan = json.loads(succeed(f"plan {ocean}/out.mcap {places}").stdout)
    assert plan["samples"]["radius_m"] == 1852.0
    assert "goals within 1852 m" in plan["message"]


@pytest.mark.parametrize(
    ("logs", "told"),
    [
        (
            (("a.nc", "feet", "1 fixes"), ("b.nc", "feet", "3 fixes", "read as time: t, depth: z")),
            ["2 logs: feet", "2 logs: 1 to 3 fixes", "b.nc: 2 variables were read by their names"],
        ),
        ((("sg1:",), ("sg2:",), ("sg2:",)), ["the logs are of 2 missions, merged as those of one"]),
        ((("sg2:",), ("sg2:",)), []),
    ],
)
def test_notes_that_several_logs_have_are_given_once_and_their_missions(logs, told):
    reports = [
        LogReport(path, "seaglider", {}, {}, (), notes=own, mission=path * path.endswith(":"))
        for path, *own in logs
    ]
    found = Account(Counts(), reports, merge([], 0.0)).notes()
    assert len(found) == len(told)
    assert all(map(str.startswith, found, told))


DIVES = 8


def messages(mean):
    """The fixes of a dive and its mean current, as a log states them."""
    ends = []
    for time_ns, longitude, latitude in mean.fixes:
        stamp = dict(zip(("sec", "nsec"), divmod(time_ns, 10**9), strict=True))
        ends.append({"time": stamp, "lon": longitude, "lat": latitude})
        place = {"longitude": longitude, "latitude": latitude}
        place["metadata"] = [{"key": "depth", "value": "0"}]
        yield Message(time_ns, "/fix", "foxglove.LocationFix", place, 0, 0)
    east, north = mean.velocity
    payload = {"dive": mean.dive, "dac_eastward": east, "dac_northward": north, "max_depth": 200.0}
    payload |= {"error": mean.error_std, "start_fix": ends[0], "end_fix": ends[1]}
    yield Message(mean.time_ns + 1, "/dac", "replay_kit.DepthAveragedCurrent", payload, 0, 0)


@pytest.fixture(scope="module")
def biased(ocean, tmp_path_factory) -> Path:
    """A mission whose flight model errs by half of the way, its result and the smoothed one."""
    folder = tmp_path_factory.mktemp("mission")
    (folder / "fast.toml").write_text(PRIOR)
    write_mcap_log(
        folder / "log.mcap", [message for k in range(DIVES) for message in messages(dive(k))]
    )
    inputs = f"{folder}/log.mcap --ensemble {ocean}/E.nc --place-ensemble --modes 10"
    for more in (
        f"replay {inputs} -o {folder}/out.mcap --json {folder}/out.json",
        f"smooth {inputs} -o {folder}/smooth.mcap",
    ):
        done = invoke(f"{more} --config {folder}/fast.toml")
        assert done.exit_code in (0, 6), done.output
    return folder


@pytest.mark.parametrize("name", ["out.mcap", "smooth.mcap"])
def test_measured_is_what_the_log_states_and_corrected_what_is_used(biased, name):
    result = rk.open_result(biased / name)
    table = result.observations
    stated = np.array([dive(k).velocity for k in range(DIVES)])
    projection = result.estimate.grid.projection
    _, longitude, latitude = np.array([dive(k).fixes[1] for k in range(DIVES)]).T
    local = np.column_stack(rotate_to_local(projection, longitude, latitude, *stated.T))

    def pairs(kind):
        return table[[f"mean_current_{kind}_east", f"mean_current_{kind}_north"]].to_numpy()

    np.testing.assert_allclose(pairs("measured"), local, atol=2e-6)
    np.testing.assert_allclose(table["mean_current_measured_standard_error"], 0.01, rtol=1e-12)
    corrected = np.isfinite(pairs("corrected")).all(axis=1)
    assert corrected.tolist() == sorted(corrected.tolist())
    assert 1 <= corrected.sum() < DIVES
    # half of the way through the water, of 25 cm/s
    apart = np.hypot(*(pairs("measured") - pairs("corrected"))[corrected].T)
    np.testing.assert_allclose(apart, 0.125, atol=0.03)
    used = np.where(corrected[:, None], pairs("corrected"), pairs("measured"))
    bins = result.innovations
    for kind, what in (("predicted", "innovation"), ("estimated", "residual")):
        stated = bins[[f"{what}_east", f"{what}_north"]]
        np.testing.assert_allclose(used - pairs(kind), stated, atol=1e-12)
    errors = table["mean_current_estimated_standard_error"].to_numpy()
    known = np.isnan(errors) if name == "smooth.mcap" else (errors > 0.0) & (errors < 0.1)
    assert known.all()


def test_summary_table_and_page_state_the_correction(biased, tmp_path):
    found = json.loads((biased / "out.json").read_text())["flight_correction"]
    observed = rk.open_result(biased / "out.mcap").observations
    assert found["corrected"] == np.isfinite(observed["mean_current_corrected_east"]).sum()
    assert found["rms_m_s"] == pytest.approx(0.125, abs=0.02)
    assert found["along"] == pytest.approx(0.5, abs=3.0 * found["along_std"])
    assert (found["dives"], found["evidence"] > 2.0) == (DIVES, True)
    result = str(biased / "out.mcap")
    succeed(f"export {result} --table dives -o {tmp_path}/dives.csv")
    table = pd.read_csv(tmp_path / "dives.csv")
    stated = np.array([dive(k).velocity for k in range(DIVES)])
    np.testing.assert_allclose(
        table[["dac_eastward_measured", "dac_northward_measured"]], stated, atol=1e-5
    )
    for name in ("measured", "corrected", "estimated"):
        assert table.iloc[-1][[f"dac_eastward_{name}", f"dac_{name}_standard_error"]].notna().all()
    assert table["dac_eastward_corrected"].isna().iloc[0]
    succeed(f"report {result} -o {tmp_path}/page.html")
    panels = figures((tmp_path / "page.html").read_text())["mean-currents"]["panels"]
    assert [mark["name"] for panel in panels for mark in panel["marks"]] == [
        "measured",
        "corrected",
        "estimated",
    ] * 2
