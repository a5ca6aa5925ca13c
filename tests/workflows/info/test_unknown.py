"""``info`` on what it does not know: what is missing, what it looks like, what to type next, and the mapping that makes it usable."""

import shlex
from pathlib import Path

import numpy as np
import pytest

from replay_kit.core.message import Message
from replay_kit.logs.mcap.writer import write_mcap_log
from tests import synthetic
from tests.command import invoke, succeed
from tests.logs.netcdf import glider_samples as made


def _cells(path: Path) -> Path:
    """A position, and a twist for each of two cells on topics of their own."""
    fix = {"latitude": -40.0, "longitude": 152.0, "status": {"status": 0}}
    messages = []
    for k in range(5):
        messages.append(Message(k * 10**9, "/gps", "sensor_msgs/msg/NavSatFix", fix, 0, 0))
        for cell in (1, 2):
            linear = {"x": 0.1 * cell, "y": -0.05, "z": 0.0}
            payload = {
                "header": {"frame_id": "enu"},
                "twist": {"linear": linear, "angular": {"x": 0.0, "y": 0.0, "z": 0.0}},
            }
            messages.append(
                Message(
                    k * 10**9, f"/adcp/cell_{cell}", "geometry_msgs/msg/TwistStamped", payload, 0, 0
                )
            )
    messages.append(Message(5 * 10**9, "/battery", "vendor.Battery", {"volts": 24.0}, 0, 0))
    write_mcap_log(path, messages)
    return path


def test_topics_of_unknown_types_are_named_with_what_to_type(tmp_path):
    log = _cells(tmp_path / "a.mcap")
    said = invoke(f"info {log}").stdout
    assert (
        "Missing for a replay: profiles of the current, or mean currents of dives with their fixes"
        in said
    )
    for cell in (1, 2):
        assert f"Unknown type: /adcp/cell_{cell} looks like a velocity" in said
    assert "Unknown type: 1 more topics" in said
    step = f"Next: replay-kit info {log} --suggest map.toml\nCorrect map.toml, then: replay-kit info {log} --config map.toml"
    assert said.rstrip().endswith(step)


def test_a_netcdf_file_of_no_known_dialect(tmp_path):
    track = made.samples(600.0)
    rows = {
        "t": track["time"],
        "lat": track["latitude"],
        "lon": track["longitude"],
        "u": np.full(10, 0.1),
        "v": np.full(10, 0.2),
    }
    log = made.write(
        tmp_path / "lab.nc",
        {
            name: (("obs",), values, made.EPOCH if name == "t" else {})
            for name, values in rows.items()
        },
    )
    said = invoke(f"info {log}").stdout
    assert "each row over t is a message on netcdf/t, with lat, lon, u, v" in said
    assert "Unknown type: netcdf/t looks like a velocity" in said
    mapping = tmp_path / "map.toml"
    succeed(f"info {log} --suggest {mapping}")
    text = mapping.read_text()
    assert 'reference = "unknown"' in text
    mapping.write_text(text.replace('"unknown"', '"earth"'))
    assert "10 profiles with 10 usable bins" in invoke(f"info {log} --config {mapping}").stdout


def test_a_netcdf_file_without_rows_is_no_log(tmp_path):
    u = (("t", "y", "x"), np.full((10, 2, 2), 0.1), {})
    log = made.write(
        tmp_path / "grid.nc", {"t": (("t",), made.samples(600.0)["time"], made.EPOCH), "u": u}
    )
    done = invoke(f"info {log}")
    assert done.exit_code == 3
    assert "got currents on a grid: t, y, x, u; a forecast is given with --ensemble" in done.stderr


def test_the_next_command_has_the_ensemble_that_was_given(tmp_path):
    log = made.bodc(tmp_path / "a.nc")
    forecast = tmp_path / "e.nc"
    synthetic.dataset(west=-30.3, south=39.8).to_netcdf(forecast, engine="h5netcdf")
    said = invoke(f"info {log} --ensemble {forecast}").stdout
    assert said.rstrip().endswith(
        f"Next: replay-kit replay {log} --ensemble {forecast} -o RESULT.mcap"
    )
    # and the settings
    options = ["--levels", "5,150", "--dead-reckoning", "through_water"]
    remaps = ["--remap", "/a b=/c", "--remap", "/d=/e"]
    said = invoke(["info", str(log), "--ensemble", str(forecast), *options, *remaps]).stdout
    words = ["--levels=5,150", "--dead-reckoning=through_water", "--remap=/a b=/c", "--remap=/d=/e"]
    last = said.rstrip().splitlines()[-1]
    assert last.startswith(f"Next: replay-kit replay {log} --ensemble {forecast} ")
    assert sorted(shlex.split(last)[6:-2]) == sorted(words)


def test_several_logs_are_a_table_and_their_notes_follow_on_request(tmp_path):
    logs = [str(made.bodc(tmp_path / name)) for name in ("a.nc", "b.nc")]
    said = invoke(["info", *logs]).stdout
    rows = [line.split() for line in said.splitlines() if line.startswith(("a.nc", "b.nc"))]
    assert [(row[0], row[-2]) for row in rows] == [("a.nc", rows[0][-2]), ("b.nc", rows[0][-2])]
    assert "-v prints them" in said
    assert len(said.splitlines()) <= 11
    assert invoke(["info", *logs, "-v"]).stdout.count("Note: DEPTH_Z: has") == 2
    assert said.rstrip().endswith("-o RESULT.mcap")


def test_info_of_a_folder_with_two_missions_ends_with_how_to_choose_one(tmp_path):
    folder = tmp_path / "a b"
    first, _ = made.seaexplorer(folder)
    (folder / "SEA063.23.gli.sub.1").write_text(first.read_text())
    done = succeed(["info", str(folder)])
    assert done.stdout.startswith("sea063.22, sea063.23 (seaexplorer)")
    step = f"Next: replay-kit info '{folder}'/SEA063.22.gli.sub.*\nThe logs are of 2 missions, of which this is one; "
    assert done.stdout.rstrip().endswith(f"{step}the others: '{folder}'/SEA063.23.gli.sub.1")


def test_the_command_printed_runs(tmp_path, monkeypatch):
    log, mapping = _cells(tmp_path / "a b.mcap"), tmp_path / "map.toml"
    monkeypatch.chdir(tmp_path)
    first, then = invoke(["info", str(log)]).stdout.splitlines()[-2:]
    succeed(shlex.split(first.removeprefix("Next: replay-kit ")))
    mapping.write_text(mapping.read_text().replace('"unknown"', '"earth"'))
    done = invoke(shlex.split(then.removeprefix("Correct map.toml, then: replay-kit ")))
    succeed("synthesize --ensemble FORECAST.nc --truth T.nc --members 3")
    command = shlex.split(done.stdout.splitlines()[-1].removeprefix("Next: replay-kit "))
    assert invoke([*command, "--place-ensemble", "--modes", "5"]).exit_code in (0, 6)
    assert (tmp_path / "RESULT.mcap").exists()


@pytest.mark.parametrize(
    ("write", "ending"),
    [(made.bodc, "--ensemble FORECAST.nc -o RESULT.mcap"), (made.spray, "-o RESULT.mcap")],
)
def test_a_gliders_log_is_ready_for_a_replay(tmp_path, write, ending):
    said = invoke(["info", str(write(tmp_path / "a b.nc"))]).stdout
    assert f"Next: replay-kit replay '{tmp_path / 'a b.nc'}'" in said
    assert said.rstrip().endswith(ending)
    assert "Use: ready for replay: " in said


def test_a_log_without_currents_says_what_to_add(tmp_path):
    folder = tmp_path / "raw"
    made.seaexplorer(folder)
    said = invoke(f"info {folder}").stdout
    step = f"Next: replay-kit info {folder} ANOTHER_LOG\nANOTHER_LOG is a log of this mission with the missing data"
    assert said.rstrip().endswith(step)
    assert "SeaExplorer raw: 2 files are one log" in said
