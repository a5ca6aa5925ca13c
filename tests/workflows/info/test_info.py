"""``replay-kit info``: what logs and forecasts hold, what is missing, what to type next, and the mapping that makes the unknown usable."""

import io
import json
import shlex
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

from replay_kit.config.run import load_config
from replay_kit.core.message import Message
from replay_kit.logs.mcap import index
from replay_kit.logs.mcap.writer import write_mcap_log
from replay_kit.show.text import SafeConsole
from replay_kit.workflows.info.inspect import inspect_logs
from replay_kit.workflows.info.listing import print_infos
from tests import synthetic
from tests.command import invoke, succeed
from tests.forecast import forms
from tests.forecast.forms import save
from tests.logs.netcdf import glider_samples as made
from tests.measurements.carriers import json_mcap
from tests.measurements.samples import fix, ping
from tests.places import DATA, needs

MODELS = DATA / "models"


def rows_of(*messages):
    """Messages as rows of a log, a second apart."""
    return [(k, one.topic, one.schema, one.payload) for k, one in enumerate(messages)]


@pytest.fixture
def vendor(tmp_path):
    """A log of a fix, a ping, and topics of unknown types, one of them with positions; a mean current's places are none."""
    nav = [{"pos": {"lat": -40.0, "lon": 152.0 + k}, "depth": 5.0 * k} for k in range(3)]
    dac = {"start_fix": {"lat": 1.0, "lon": 2.0}}
    rows = [
        *rows_of(fix(0), ping(1)),
        *((k, "/vendor/nav", "vendor.Nav", payload) for k, payload in enumerate(nav)),
        (9, "/vendor/text", "vendor.Text", {"words": "none"}),
        (9, "/dac", "replay_kit.DepthAveragedCurrent", dac),
        (9, "mavlink/1/1/VFR_HUD", "mavlink.1.1.VFR_HUD", {"header": {}, "message": {"alt": 3.0}}),
    ]
    path = tmp_path / "vendor.mcap"
    path.write_bytes(json_mcap(rows))
    return path


def test_a_suggested_mapping_makes_the_topic_usable(vendor, tmp_path):
    before = inspect_logs([vendor], load_config(None))[0]
    assert set(before.unknown) == {"/vendor/nav", "/vendor/text"}
    assert before.not_used["/dac"] == {"depth-averaged current: not a number": 1}
    said = succeed(f"info {vendor} --suggest -")
    assert 'topic = "/vendor/nav"' in said.stdout
    assert "/adcp" not in said.stdout
    assert "mavlink" not in said.stdout
    assert "Use: ready for replay" in said.stderr
    (tmp_path / "map.toml").write_text(said.stdout)
    answer = json.loads(succeed(f"info {vendor} --config {tmp_path}/map.toml --json -").stdout)
    assert answer["logs"][0]["positions"] == before.content.positions + 3


def test_every_note_of_the_reader_and_what_is_damaged_or_unchecked_is_printed(vendor):
    found, text = inspect_logs([vendor], load_config(None))[0], io.StringIO()
    told = {
        "notes": ("the clock was set twice",),
        "undecodable": {"/raw": (7, "no schema")},
        "unchecked": {"chunks": 3},
    }
    found = replace(found, report=replace(found.report, **told))
    print_infos([found], SafeConsole(file=text, width=200))
    for words in ("the clock was set twice", "decoded: 7 x /raw: no schema", "Without a checksum"):
        assert words in text.getvalue()


def test_logs_given_together_are_judged_together(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    fixes, pings = rows_of(*[fix(0)] * 30), rows_of(*[ping(0)] * 25)
    for name, rows in (("places", fixes), ("pings", pings), ("more", pings[:2])):
        (tmp_path / f"{name}.mcap").write_bytes(json_mcap(rows))
    said = invoke("info places.mcap pings.mcap").stdout
    for words in ("Together: ready for replay", "25 profiles", "replay places.mcap pings.mcap"):
        assert words in said
    assert "Missing" not in said
    said = invoke("info more.mcap pings.mcap").stdout
    assert said.count("Missing for a replay: positions\n") == 1


@pytest.fixture
def large(tmp_path, monkeypatch):
    """A log of 400 fixes, 2 pings and 400 messages of an unknown type, which counts as large."""
    monkeypatch.setattr(index, "FEW_MESSAGES", 10)
    known = rows_of(fix(0), ping(1), fix(2), ping(3))
    fixes = [(1000 + k, *known[0][1:]) for k in range(398)]
    other = [(k, "/vendor/text", "vendor.Text", {"n": k}) for k in (*range(399), 50)]
    path = tmp_path / "vendor.mcap"
    path.write_bytes(json_mcap([*known, *fixes, *other]))
    return path


COUNTED = {"/adcp": 2, "/vehicle/fix": 400, "/vendor/text": 400}
TOO_MANY = {"profiles", "bins", "mean_currents", "positions", "dives", "box", "depths"}


def test_a_large_log_is_described_by_its_index_and_what_that_does_not_know_said_to_need_full(large):
    found = inspect_logs([large], load_config(None))[0]
    # a hundred of each topic that has so many
    assert found.sampled == 202
    assert {name: topic.messages for name, topic in found.topics.items()} == COUNTED
    text = found.topics["/vendor/text"]
    assert (text.first_ns, text.last_ns) == (0, 398 * 10**9)
    done = succeed(f"info {large} --json -")
    for words in ("the index, and 202 messages", "--full counts", "by the messages read: ready"):
        assert words in done.stderr
    (answer,) = json.loads(done.stdout)["logs"]
    assert answer["read"] == {"whole": False, "messages": 202}
    assert {key for key in TOO_MANY if answer[key] is None} == TOO_MANY


def test_what_is_read_whole_is_counted_and_decoded(large):
    full = invoke(f"info {large} --full --json -")
    (answer,) = json.loads(full.stdout)["logs"]
    assert answer["read"] == {"whole": True, "messages": 802}
    assert (answer["profiles"], answer["positions"]) == (2, 400)
    # one of them was decoded
    assert [reason["count"] for reason in answer["not_used"]["/vendor/text"]] == [400]
    # a log that was cut needs an explanation, one that was asked for none
    large.write_bytes(large.read_bytes()[:-40])
    done = invoke(f"info {large}")
    assert (done.exit_code, "400 positions" in done.stdout) == (4, True)
    assert ("all of it was read" in done.stdout, "all of it was read" in full.stderr) == (
        True,
        False,
    )


def cells(path):
    """A position, and a twist for each of two cells on topics of their own."""
    place = {"latitude": -40.0, "longitude": 152.0, "status": {"status": 0}}
    still = dict.fromkeys("xyz", 0.0)
    messages = [Message(5 * 10**9, "/battery", "vendor.Battery", {"volts": 24.0}, 0, 0)]
    for k in range(5):
        kinds = [("/gps", "sensor_msgs/msg/NavSatFix", place)]
        for cell in (1, 2):
            twist = {"linear": {"x": 0.1 * cell, "y": -0.05, "z": 0.0}, "angular": still}
            payload = {"header": {"frame_id": "enu"}, "twist": twist}
            kinds.append((f"/adcp/cell_{cell}", "geometry_msgs/msg/TwistStamped", payload))
        messages += [Message(k * 10**9, *kind, 0, 0) for kind in kinds]
    write_mcap_log(path, messages)
    return path


def test_topics_of_unknown_types_are_named_and_what_is_printed_to_type_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    said = invoke(["info", str(cells(tmp_path / "a b.mcap"))]).stdout
    assert "Missing for a replay: profiles of the current, or mean currents of dives" in said
    for cell in (1, 2):
        assert f"Unknown type: /adcp/cell_{cell} looks like a velocity" in said
    first, then = said.splitlines()[-2:]
    succeed(shlex.split(first.removeprefix("Next: replay-kit ")))
    mapping = tmp_path / "map.toml"
    mapping.write_text(mapping.read_text().replace('"unknown"', '"earth"'))
    done = invoke(shlex.split(then.removeprefix("Correct map.toml, then: replay-kit ")))
    succeed("synthesize --ensemble FORECAST.nc --truth T.nc --members 3")
    command = shlex.split(done.stdout.splitlines()[-1].removeprefix("Next: replay-kit "))
    assert invoke([*command, "--place-ensemble", "--modes", "5"]).exit_code in (0, 6)
    assert (tmp_path / "RESULT.mcap").exists()


def test_a_plan_alone_is_a_result_to_be_opened(tmp_path):
    plan = json_mcap([(0, "/plan/controls", "replay_kit.Plan", {"speed": 0.3, "depth": 5.0})])
    (tmp_path / "plan.mcap").write_bytes(plan)
    said = succeed(f"info {tmp_path}/plan.mcap").stdout
    assert "Use: a result of replay or plan" in said
    assert said.splitlines()[-1] == f"Next: replay-kit report {tmp_path}/plan.mcap"


def test_pings_of_which_no_bin_can_be_used_lead_to_their_quality_control(tmp_path):
    log = tmp_path / "fast.mcap"
    log.write_bytes(json_mcap(rows_of(fix(0), ping(1, n_cells=1, velocity=[[20.0] * 3]))))
    assert "Bins: none usable; replay-kit qc" in invoke(f"info {log}").stdout


def test_a_netcdf_file_of_no_known_dialect_is_rows_and_without_rows_no_log(tmp_path):
    track = made.samples(600.0)
    rows = {"t": track["time"], "lat": track["latitude"], "lon": track["longitude"]}
    rows |= {"u": np.full(10, 0.1), "v": np.full(10, 0.2)}
    attributes = {"t": made.EPOCH}
    columns = {name: (("obs",), one, attributes.get(name, {})) for name, one in rows.items()}
    log, mapping = made.write(tmp_path / "lab.nc", columns), tmp_path / "map.toml"
    said = invoke(f"info {log}").stdout
    assert "each row over t is a message on netcdf/t, with lat, lon, u, v" in said
    assert "Unknown type: netcdf/t looks like a velocity" in said
    succeed(f"info {log} --suggest {mapping}")
    mapping.write_text(mapping.read_text().replace('"unknown"', '"earth"'))
    assert "10 profiles with 10 usable bins" in invoke(f"info {log} --config {mapping}").stdout
    grid = {
        "t": (("t",), track["time"], made.EPOCH),
        "u": (("t", "y", "x"), np.zeros((10, 2, 2)), {}),
    }
    done = invoke(f"info {made.write(tmp_path / 'grid.nc', grid)}")
    assert done.exit_code == 3
    assert "a forecast is given with --ensemble" in done.stderr


def test_the_next_command_has_the_ensemble_and_the_settings_that_were_given(tmp_path):
    log, forecast = made.bodc(tmp_path / "a.nc"), tmp_path / "e.nc"
    synthetic.dataset(west=-30.3, south=39.8).to_netcdf(forecast, engine="h5netcdf")
    options = ["--levels", "5,150", "--dead-reckoning", "through_water"]
    remaps = ["--remap", "/a b=/c", "--remap", "/d=/e"]
    said = invoke(["info", str(log), "--ensemble", str(forecast), *options, *remaps]).stdout
    words = ["--levels=5,150", "--dead-reckoning=through_water", "--remap=/a b=/c", "--remap=/d=/e"]
    last = said.rstrip().splitlines()[-1]
    assert last.startswith(f"Next: replay-kit replay {log} --ensemble {forecast} ")
    assert sorted(shlex.split(last)[6:-2]) == sorted(words)


def two_missions(folder):
    first, _ = made.seaexplorer(folder)
    (folder / "SEA063.23.gli.sub.1").write_text(first.read_text())
    return folder


@pytest.mark.parametrize(
    ("write", "words"),
    [
        (made.bodc, ["Use: ready for replay", "replay 'X' --ensemble FORECAST.nc -o RESULT.mcap"]),
        (
            lambda path: made.seaexplorer(path) and path,
            ["SeaExplorer raw: 2 files are one log", "info 'X' ANOTHER_LOG\nANOTHER_LOG is a log"],
        ),
        (
            two_missions,
            [
                "sea063.22, sea063.23 (seaexplorer)",
                "info 'X'/SEA063.22.gli.sub.*\nThe logs are of 2 missions",
                "the others: 'X'/SEA063.23.gli.sub.1",
            ],
        ),
    ],
)
def test_what_comes_next_for_a_gliders_log_is_said(tmp_path, write, words):
    path = tmp_path / "a b"
    said = invoke(["info", str(write(path))]).stdout
    assert [each for each in words if each.replace("X", str(path)) not in said] == []


def described(*words):
    """What ``info`` says of a forecast in JSON, and the same in words."""
    done = succeed(["info", "--ensemble", *map(str, words), "--json", "-"], columns=300)
    return json.loads(done.stdout)["forecast"], done.stderr


NEMO = tuple(f"nemo_ORCA025_{name}.nc" for name in ("U", "V", "coordinates"))


@needs(MODELS)
@pytest.mark.parametrize(
    ("files", "dialect", "grids", "size", "wet"),
    [
        (NEMO, "NEMO", 1, [200, 150, 75], 0.69),
        pytest.param(NEMO[:2], "NEMO", 0, [200, 150, 75], 0.69, marks=pytest.mark.full),
        (("access_om2_u.nc", "access_om2_v.nc"), "MOM5 (B-grid)", 0, [8, 11, 4], 1.0),
        (("roms_ocean_his_0001.nc", "roms_grid.nc"), "ROMS or CROCO", 1, [7, 12, 3], 1.0),
    ],
)
def test_real_files_of_models(files, dialect, grids, size, wet):
    found, _ = described(*(MODELS / name for name in files))
    assert found["arrangement"].startswith(f"{dialect} names")
    assert len(found["grid_files"]) == grids
    assert [*found["grid"], len(found["levels"])] == size
    assert found["wet_share"] == pytest.approx(wet, abs=0.01)
    assert found["use"].startswith("one field, which --truth takes; no ensemble")
    assert found["axes"]["read_along"] == "grid"
    assert not found["axes_check"]["contradicted"]


@needs(MODELS)
def test_a_file_of_a_grid_is_told_to_hold_no_current():
    found, _ = described(MODELS / "enkfc_grid_spec.nc")
    assert found["use"].startswith("no current: a file of the grid or of other variables (depth_t")
    assert (found["grid_files"], found["members"]) == (["enkfc_grid_spec.nc"], [])


@pytest.fixture
def forecast():
    axes = forms.lonlat()
    return forms.standard(*forms.regular(*axes), *axes)


def test_a_log_says_which_of_several_times_of_a_forecast_is_taken(tmp_path, forecast):
    times = np.datetime64("2020-01-01", "ns") + np.arange(9) * np.timedelta64(1, "D")
    fields = [(1.0 + 0.1 * np.sin(k)) * forecast.isel(member=0) for k in range(times.size)]
    log, days = tmp_path / "log.mcap", tmp_path / "days.nc"
    save(xr.concat(fields, xr.DataArray(times, dims="time", name="time")), days)
    place = dict(
        zip(("longitude", "latitude"), (float(axis.mean()) for axis in forms.lonlat()), strict=True)
    )
    at = int(times[3].astype(np.int64)), "/vehicle/fix", "foxglove.LocationFix", place
    write_mcap_log(log, [Message(*at, 0, 0)])
    rule = "--members", "times:4d"
    assert described(days, *rule)[0]["time"] == "2020-01-09T00:00:00Z"
    done = invoke(f"info {log} --ensemble {days} {' '.join(rule)} --json -")
    assert json.loads(done.stdout)["forecast"]["time"] == "2020-01-04T00:00:00Z"


def test_members_and_their_origin_are_shown(tmp_path, forecast):
    for k in range(3):
        save(forecast.isel(member=k), tmp_path / f"mem{k:03d}.nc")
    found, said = described(f"{tmp_path}/mem*.nc")
    for words in ("3 by --members files", "CF names", "true east and north", "of 3 members"):
        assert words in said
    assert found["members"] == ["mem000.nc", "mem001.nc", "mem002.nc"]
    assert found["members_rule"] == "files"
    many, said = described(save(synthetic.dataset(), tmp_path / "many.nc"))
    assert many["members_rule"] == "dim:member"
    assert ["many.nc member 7" in said, "many.nc member 3" in said] == [True, False]


def test_info_needs_a_log_or_a_forecast(tmp_path):
    for more, code, words in (
        ("", 2, "expected a log, or a forecast with --ensemble"),
        (f" --ensemble {tmp_path}/none*.nc", 3, "no file matches this pattern"),
    ):
        done = invoke(f"info{more}")
        assert (done.exit_code, words in done.output) == (code, True)
