"""What a replay publishes of a dive's mean current: the log's own value everywhere, and the correction under a name of its own."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import replay_kit as rk
from replay_kit.core.geodesy import rotate_to_local
from replay_kit.core.message import Message
from replay_kit.logs.mcap.writer import write_mcap_log
from tests import synthetic
from tests.command import invoke, succeed
from tests.show.report.html_of import figures
from tests.workflows.replay.test_flight_bias import dive

DIVES = 8
FAST = "--modes 10 --place-ensemble --config {}/fast.toml"
PRIOR = "[estimator]\nsample_share = 0.5\nshift_distance = 0.0\n"


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
def replayed(tmp_path_factory) -> Path:
    """A mission whose flight model errs by half of the way, its result and the smoothed one."""
    folder = tmp_path_factory.mktemp("mission")
    synthetic.dataset(seed=4, n_members=12, shape=(5, 5)).to_netcdf(
        folder / "E.nc", engine="h5netcdf"
    )
    (folder / "fast.toml").write_text(PRIOR)
    write_mcap_log(
        folder / "log.mcap", [message for k in range(DIVES) for message in messages(dive(k))]
    )
    inputs = f"{folder}/log.mcap --ensemble {folder}/E.nc {FAST.format(folder)}"
    done = invoke(f"replay {inputs} -o {folder}/out.mcap --json {folder}/out.json")
    assert done.exit_code in (0, 6), done.output
    again = invoke(f"smooth {inputs} -o {folder}/smooth.mcap")
    assert again.exit_code in (0, 6), again.output
    return folder


@pytest.mark.parametrize("name", ["out.mcap", "smooth.mcap"])
def test_measured_is_what_the_log_states_and_corrected_what_is_used(replayed, name):
    result = rk.open_result(replayed / name)
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


def test_the_summary_states_the_correction(replayed):
    folder = replayed
    found = json.loads((folder / "out.json").read_text())["flight_correction"]
    table = rk.open_result(folder / "out.mcap").observations
    assert found["corrected"] == np.isfinite(table["mean_current_corrected_east"]).sum()
    assert found["rms_m_s"] == pytest.approx(0.125, abs=0.02)
    assert found["along"] == pytest.approx(0.5, abs=3.0 * found["along_std"])
    assert (found["dives"], found["evidence"] > 2.0) == (DIVES, True)


def test_table_and_page_name_both(replayed, tmp_path):
    result = str(replayed / "out.mcap")
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
