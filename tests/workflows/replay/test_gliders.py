"""Gliders' files through the commands: what a replay makes of mean currents alone, and what is said of pings that are lost."""

import json

import numpy as np
import pytest

from replay_kit.core.as_flown import AsFlown
from replay_kit.core.message import LogReport
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
    ("name", "used"),
    [
        pytest.param("seagliderOG1_sg033_delayed.nc", 18, marks=pytest.mark.full),
        ("og1_sp028_20230202T1637_R.nc", 9),
    ],
)
def test_mean_currents_of_real_files_are_used(ocean, name, used):
    answer = replayed(ocean, DATA / "glider" / name)
    (dac,) = (row for row in answer["messages"] if row["topic"] == "/dac")
    assert (dac["read"], dac["used"]) == (used, used)
    assert answer["observations"]["used"] + answer["observations"]["rejected"] == used


@needs(DATA / "seaglider")
def test_a_result_keeps_the_declination_and_a_plan_the_radius_of_the_log(ocean):
    """The last dive's: the radius was 2000 m before."""
    replayed(ocean, " ".join(f"{DATA}/seaglider/p171010{dive}.nc" for dive in (3, 4)))
    flown = AsFlown.in_metadata(metadata_of(ocean / "out.mcap"))
    # the file has it in single precision
    assert flown.declination == pytest.approx(-1.2, abs=1e-6)
    places = "--start 85.91,12.13,0 --goal 85.95,12.13,0 --samples 3 --json -"
    plan = json.loads(succeed(f"plan {ocean}/out.mcap {places}").stdout)
    assert plan["samples"]["radius_m"] == 1852.0
    assert "goals within 1852 m" in plan["message"]


@pytest.mark.parametrize(
    ("logs", "told"),
    [
        ((("a.nc", "feet", "miles"), ("b.nc", "feet")), ["2 logs: feet", "a.nc: miles"]),
        (
            (("a.nc", "1 fixes"), ("b.nc", "3 fixes", "read as time: t, depth: z")),
            ["2 logs: 1 to 3 fixes", "b.nc: 2 variables were read by their names"],
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
