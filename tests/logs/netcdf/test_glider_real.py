"""The table in ``logs/netcdf/README.md``: what each real file holds, counted in the file itself and in the messages of its reader."""

from collections import Counter
from datetime import UTC, datetime
from pathlib import Path

import pytest

from replay_kit.logs import open_log, open_logs
from tests.places import DATA, ROOT, needs

FOLDER = DATA / "glider"
pytestmark = needs(FOLDER)

# file, dialect, dives, mean currents, fixes; as in the README
ROWS = [
    ("seagliderOG1_sg033_delayed.nc", "og1", 19, 18, 43),
    ("og1_sp028_20230202T1637_R.nc", "og1", 4, 9, 9),
    ("pyglider_L0_dfo-eva035.nc", "pyglider", 12, 0, 0),
    ("gdac_ru29_profile.nc", "gliderdac", 1, 0, 0),
    ("gdac_Murphy_rt.nc", "gliderdac", 1, 0, 0),
    ("p2710001.nc", "seaglider", 1, 0, 3),
    ("seaexplorer/sea046.45.gli.sub.10.gz", "seaexplorer", 1, 0, 0),
    ("seaexplorer/sea046.45.pld1.raw.10.gz", "seaexplorer", 1, 0, 0),
    ("seaexplorer/sea063.22.gli.sub.120.gz", "seaexplorer", 1, 0, 0),
    ("seaexplorer/sea063.22.pld1.sub.120.gz", "seaexplorer", 1, 0, 0),
]


def _read(name):
    log = open_log(FOLDER / name)
    messages = list(log.messages())
    assert [message.time_ns for message in messages] == sorted(
        message.time_ns for message in messages
    )
    return log.report(), messages


def _of(messages, topic):
    return [message for message in messages if message.topic == topic]


def _dives(messages):
    """Times that the depth of the positions goes below 3 m, counted anew below 1.5 m."""
    count, under = 0, False
    for message in messages:
        if message.topic.startswith("/vehicle"):
            depth = float(message.payload["metadata"][0]["value"])
            count += depth > 3.0 and not under
            under = depth > 3.0 or (under and depth > 1.5)
    return count


@pytest.mark.parametrize("row", ROWS, ids=[Path(row[0]).name for row in ROWS])
def test_each_file_is_read_as_the_readme_states(row):
    name, dialect, dives, means, fixes = row
    report, messages = _read(name)
    counts = Counter(message.topic for message in messages)
    assert (report.format, counts["/dac"], counts["/vehicle/fix"]) == (dialect, means, fixes)
    assert report.losses == ()
    assert (
        f"| `{name}` | {dialect} | {dives} | {means} | {fixes} |"
        in (ROOT / "replay_kit/logs/netcdf/README.md").read_text()
    )
    assert _dives(messages) == dives


def test_mean_currents_of_sp028_begin_at_the_mirror_of_their_end():
    report, messages = _read("og1_sp028_20230202T1637_R.nc")
    last = _of(messages, "/dac")[-1].payload
    assert (last["dac_eastward"], last["dac_northward"]) == (-0.0242, -0.1603)
    # the file states the middle of the dive, 1675455900 at 38.24685 N, and its end
    assert (last["start_fix"]["time"]["sec"], last["end_fix"]["time"]["sec"]) == (
        1_675_454_640,
        1_675_457_160,
    )
    assert (last["start_fix"]["lat"], last["end_fix"]["lat"]) == (
        pytest.approx(38.248),
        pytest.approx(38.2457),
    )
    assert last["max_depth"] == pytest.approx(108.4312)
    assert "mean current: 9 in 372 values, each counted once" in report.notes


def test_mean_currents_that_are_none_are_said_to_be_missing():
    assert (
        "mean current: 1 of exactly (0, 0) taken as missing" in _read("gdac_Murphy_rt.nc")[0].notes
    )
    report, _ = _read("p2710001.nc")
    assert report.undecodable == {"/dac": (1, "mean current flagged bad (depth_avg_curr_qc)")}
    assert "salinity_qc, depth_avg_curr_qc: 1 x 4 (QC_BAD), not used" in report.notes
    assert "magnetic_variation: declination 111.7 degrees" in report.notes


def test_the_two_files_of_a_seaexplorer_are_one_log_with_places_in_degrees():
    paths = sorted((FOLDER / "seaexplorer").glob("sea063*"))
    (log,) = open_logs(paths)
    first = next(iter(log.messages()))
    assert first.payload["latitude"] == pytest.approx(55.0 + 29.384 / 60.0)
    assert first.payload["longitude"] == pytest.approx(16.0 + 16.141 / 60.0)
    assert first.time_ns == int(datetime(2021, 8, 23, 23, 22, 20, tzinfo=UTC).timestamp()) * 10**9
    assert any(note.startswith("AD2CP in real time: one cell") for note in log.report().notes)
    (west,) = open_logs([FOLDER / "seaexplorer" / "sea046.45.gli.sub.10.gz"])
    assert next(iter(west.messages())).payload["longitude"] == pytest.approx(
        -(128.0 + 13.450 / 60.0)
    )


def test_headings_of_pyglider_are_degrees():
    report, messages = _read("pyglider_L0_dfo-eva035.nc")
    assert not any("radians" in note for note in report.notes)
    metadata = {item["key"]: item["value"] for item in messages[0].payload["metadata"]}
    assert (metadata["heading"], metadata["pitch"], metadata["roll"]) == ("108.86", "40.69", "0.32")
