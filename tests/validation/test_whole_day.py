"""The whole at once: a day of a ship at 1 Hz, gliders with goals, a radar, a forecast by address: no screen contradicts another."""

import json
import re

import numpy as np
import pytest
import xarray as xr

import replay_kit as rk
from replay_kit.config.run import RunConfig
from replay_kit.forecast import read_truth
from replay_kit.logs.mcap.writer import write_mcap_log
from replay_kit.studies.twins.field import build_field
from replay_kit.studies.twins.make import Twin, make_twin, measure, messages
from tests.benchmarks.long import survey
from tests.benchmarks.scene import NOISE
from tests.command import invoke, succeed
from tests.forecast.remote.servers import Files, serving, zarr_objects
from tests.logs.surface_samples import totals
from tests.places import SAMPLES

DAY = 86_400
GOALS = "--goal g1=152.8,-40.1,300 --goal g2=152.6,-40.1,0"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with the logs of each vehicle in a folder of its own."""
    found = tmp_path_factory.mktemp("whole")
    for name in ("ship", "g1", "g2"):
        (found / name).mkdir()
    truth = read_truth(str(SAMPLES / "truth.nc"), RunConfig().forecast)
    field, rng = build_field(truth), np.random.default_rng(3)
    mission = survey(field, DAY)
    velocity = measure(field, mission.place, NOISE, rng)
    write_mcap_log(found / "ship/ship.mcap", messages(mission, velocity, NOISE))
    for seed in (1, 2):
        make_twin(truth, Twin("glider", 130, 0.09, seed), found / f"g{seed}" / f"g{seed}.mcap")
    radar = totals((0.1, -0.1), hours=24, west=152.3, south=-40.3)
    hours = np.datetime64("2018-11-16", "ns") + np.arange(24) * np.timedelta64(3600 * 10**9, "ns")
    radar.assign_coords(time=hours).to_netcdf(found / "g2" / "radar.nc")
    return found


@pytest.mark.full
def test_a_day_of_three_vehicles_is_told_alike_by_every_command(folder, monkeypatch):
    monkeypatch.setenv("HOME", str(folder))
    vehicles = " ".join(f"--as {name}={folder / name}" for name in ("ship", "g1", "g2"))
    out, more = folder / "out.mcap", f"{vehicles} {GOALS} --report"
    with xr.open_dataset(SAMPLES / "ensemble.nc") as ensemble:
        objects = zarr_objects(ensemble, zarr_format=2)
    with serving(Files(objects)) as files:
        done = succeed(
            f"replay {more} --ensemble {files.url} -o {out} --json {folder / 'out.json'}"
        )
        followed = folder / "followed.mcap"
        succeed(
            f"replay {more} --ensemble {files.url} -o {followed} --follow --interval 1 --until-idle 1"
        )
    told = json.loads((folder / "out.json").read_text())
    status = json.loads(succeed(f"status {out} --json -").stdout)["vehicles"]
    result = rk.open_result(out)
    assert list(told["vehicles"]) == list(status) == list(result.outcome.vehicles)
    for name, own in told["vehicles"].items():
        opened = result.outcome.vehicles[name].to_json()
        assert {key: own[key] for key in opened if key in own} == opened
        assert status[name]["fit"]["verdict"] == own["verdict"]
        page = (folder / f"out.{name}.html").read_text(encoding="utf-8")
        used = own["observations"]["used"]
        assert re.search(rf'data-key="[\w.]*observations.used" value="{used}"', page)
        assert f"{name} " in done.stdout
        if own["plan"] is not None:
            assert status[name]["odds"]["reached"] == own["plan"]["odds"]["reached"]
    # the radar's current is not the truth's: where it was assimilated before, a few pings contradict the estimate
    assert told["vehicles"]["ship"]["observations"]["used"] > 0.999 * DAY
    assert told["exit_code"] == max(told["exit_codes"], default=0)
    # the same from its inputs, and as it was followed but for the times of plans
    verified = succeed(f"verify {out} --inputs {folder} --inputs {folder}/.cache/replay-kit")
    assert "the same values" in verified.stdout
    apart = invoke(f"compare {out} {followed}")
    assert apart.exit_code == 5
    differing = {line.split(":")[0] for line in apart.stdout.splitlines()}
    planned = ("settings.planner.when", "surfacings", "plans", "plan_tracks")
    assert all(one.endswith(planned) for one in differing if "replay_kit.inputs" not in one)
    succeed(f"export {out} -o {folder / 'all.nc'}")
    with xr.open_dataset(folder / "all.nc", engine="h5netcdf") as tables:
        assert tables.sizes["dives"] == sum(len(v["by_dive"]) for v in told["vehicles"].values())
    assert list(json.loads(succeed(f"plan {out} --json -").stdout)["vehicles"]) == ["g1", "g2"]
