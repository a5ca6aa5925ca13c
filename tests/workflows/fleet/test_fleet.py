"""Many missions: the bytes of each are those of a replay on its own; what is done is kept, what fails is listed, and the rest goes on."""

import csv
import hashlib
import json
import shutil
import sys
from dataclasses import replace

import pytest

from replay_kit.core.errors import ForecastError
from replay_kit.show.text import SafeConsole
from replay_kit.workflows.fleet.page import exit_code, fleet_page, print_fleet, row_of
from replay_kit.workflows.fleet.run import Outcome, failure, run_fleet, run_mission
from replay_kit.workflows.planning.adapters import planner_of
from replay_kit.workflows.replay.inputs.job import Vehicle
from replay_kit.workflows.replay.replay import replay
from tests.command import invoke
from tests.workflows.fleet.missions import missions_in


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.glob("*.mcap")}


@pytest.fixture(scope="module")
def alone(table, tmp_path_factory):
    """The results of ordinary replays, one by one."""
    out = tmp_path_factory.mktemp("alone")
    for mission in missions_in(table, out):
        replay(mission.job, mission.config, planner_of)
    return contents(out)


def last(each):
    return list(each)[-1]


def test_a_fleet_gives_the_bytes_of_its_missions_one_by_one(table, alone, cluster, tmp_path):
    missions = missions_in(table, tmp_path)
    told = []
    outcomes = last(run_fleet(missions, cluster, False, lambda *step: told.append(step[:2])))
    assert [outcome.name for outcome in outcomes] == ["twin00", "twin01"]
    assert not any(outcome.failed or outcome.kept for outcome in outcomes)
    assert contents(tmp_path) == alone
    assert told == [(0, 2), (1, 2), (2, 2)]
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "twin00.json",
        "twin00.mcap",
        "twin01.json",
        "twin01.mcap",
    ]


def test_the_vehicles_of_a_sea_share_an_estimate_as_in_a_replay_of_them(table, tmp_path):
    sea = table.parent / "sea.toml"
    vehicles = {"a": "twin00.mcap", "b": "twin01.mcap"}
    entry = "".join(f'vehicles.{name} = "{log}"\n' for name, log in vehicles.items())
    sea.write_text(table.read_text().replace('each = "twin*.mcap"\n', entry))
    (mission,) = missions_in(sea, tmp_path)
    assert mission.name == "a-b"
    outcome = run_mission(mission)
    assert not outcome.failed, outcome.failed
    assert set(outcome.answer["vehicles"]) == set(vehicles)
    named = tuple(Vehicle(name, (table.parent / log,)) for name, log in vehicles.items())
    job = replace(mission.job, out=tmp_path / "own.mcap", vehicles=named)
    replay(job, mission.config, planner_of)
    assert job.out.read_bytes() == mission.result.read_bytes()
    assert run_mission(mission).kept
    renamed = replace(
        mission, job=replace(mission.job, vehicles=(replace(named[0], name="c"), named[1]))
    )
    assert not run_mission(renamed).kept


def test_what_is_done_is_not_done_again_unless_its_inputs_or_its_result_are_other_ones(
    table, cluster, tmp_path
):
    folder = tmp_path / "data"
    shutil.copytree(table.parent, folder)
    missions = missions_in(folder / table.name, tmp_path / "out")
    first = last(run_fleet(missions, cluster, False))
    assert [outcome.kept for outcome in last(run_fleet(missions, cluster, False))] == [True, True]
    missions[0].result.write_bytes(b"something else")
    again = last(run_fleet(missions, cluster, False))
    assert [outcome.kept for outcome in again] == [False, True]
    assert [outcome.sha256 for outcome in again] == [outcome.sha256 for outcome in first]
    # a record in which a number was changed is not believed
    record = missions[1].record.read_text()
    assert '"exit_code": 0' in record
    missions[1].record.write_text(record.replace('"exit_code": 0', '"exit_code": 4'))
    assert [one.kept for one in last(run_fleet(missions, cluster, False))] == [True, False]
    shutil.copy(folder / "twin00.mcap", folder / "twin01.mcap")
    changed = last(run_fleet(missions, cluster, False))
    assert [outcome.kept for outcome in changed] == [True, False]
    assert changed[1].sha256 != first[1].sha256
    assert [outcome.kept for outcome in last(run_fleet(missions, cluster, True))] == [False, False]


def test_a_forecast_of_several_missions_is_read_once_for_its_hash(table, tmp_path, monkeypatch):
    folder, sha256, made = tmp_path / "data", hashlib.sha256, []
    shutil.copytree(table.parent, folder)
    forecast = folder / "ensemble.nc"

    class Counted:
        def __init__(self, data=b""):
            self.own = sha256(data)
            self.update, self.digest = self.own.update, self.own.digest

        def hexdigest(self):
            made.append(self.own.hexdigest())
            return made[-1]

    monkeypatch.setattr(hashlib, "sha256", Counted)
    for mission in missions_in(folder / table.name, tmp_path / "out"):
        assert not run_mission(mission).failed
    assert made.count(sha256(forecast.read_bytes()).hexdigest()) == 1
    # another one of the same name is read
    shutil.copy(folder / "truth.nc", forecast)
    assert run_mission(mission).failed
    assert sha256(forecast.read_bytes()).hexdigest() in made


def test_a_mission_that_fails_is_listed_with_its_reason_and_the_others_go_on(
    table, tmp_path, scheduler
):
    folder = tmp_path / "data"
    shutil.copytree(table.parent, folder)
    (folder / "twin02.mcap").write_bytes(b"no log")
    line = f"fleet {folder}/fleet.toml -o {tmp_path}/out --scheduler {scheduler}"
    done = invoke(f"{line} --json {tmp_path}/fleet.json")
    assert done.exit_code == 3, done.output
    assert "3 missions: 2 replayed, 0 were there already, 1 failed" in done.stdout
    assert "FAILED: twin02: " in done.stdout
    assert scheduler in done.stdout
    rows = list(csv.DictReader((tmp_path / "out" / "fleet.csv").read_text().splitlines()))
    assert [row["status"] for row in rows] == ["done", "done", "failed"]
    assert 0.0 < float(rows[0]["rms_after_m_s"]) < float(rows[0]["rms_before_m_s"])
    assert float(rows[0]["truth_rmse_m_s"]) > 0.0
    assert "twin02.mcap" in rows[2]["failed"]
    answer = json.loads((tmp_path / "fleet.json").read_text())
    assert answer["failed"] == ["twin02"]
    assert [row["sha256"] for row in answer["missions"]] == [row["sha256"] for row in rows]
    assert "<li>twin02: " in (tmp_path / "out" / "index.html").read_text()
    assert invoke(line).exit_code == 2
    assert "2 were there already" in invoke(f"{line} --resume").stdout


def test_a_dry_run_reads_everything_and_writes_nothing_without_the_extra(
    table, tmp_path, monkeypatch
):
    # as where it is not installed
    for name in ("dask", "distributed"):
        monkeypatch.setitem(sys.modules, name, None)
    done = invoke(f"fleet {table} -o {tmp_path}/out --workers 2 --dry-run --json -")
    answer = json.loads(done.stdout)
    assert (answer["status"], answer["exit_code"], answer["workers"]) == ("dry run", 0, 2)
    assert [mission["profiles"] for mission in answer["missions"]] == [6, 6]
    assert 0.0 < answer["seconds"] < 60.0
    assert not (tmp_path / "out").exists()
    refused = invoke(f"fleet {table} -o {tmp_path}/out --scheduler tcp://127.0.0.1:1")
    assert (refused.exit_code, "pip install 'replay-kit[fleet]'" in refused.output) == (2, True)


def test_logs_without_a_table_are_missions_of_their_own(table, tmp_path, scheduler):
    files = f"{table.parent}/twin*.mcap --ensemble {table.parent}/ensemble.nc -o {tmp_path}/out"
    done = invoke(f"fleet {files} --scheduler {scheduler} --dry-run")
    assert "2 missions on 2 workers" in done.stdout, done.output


@pytest.mark.skipif(sys.platform == "win32", reason="file size limits are POSIX")
def test_on_a_full_disk_a_mission_fails_in_words_and_leaves_nothing_half_done(
    table, alone, tmp_path
):
    from tests.workflows.disk import full_disk

    missions = missions_in(table, tmp_path)
    run_mission(missions[1])
    with full_disk(3000):
        outcome = run_mission(missions[0])
    assert "is the disk full?" in outcome.failed
    assert outcome.exit_code == 1
    assert sorted(path.name for path in tmp_path.glob("twin*")) == ["twin01.json", "twin01.mcap"]
    assert run_mission(missions[1]).kept
    assert not run_mission(missions[0]).failed
    assert contents(tmp_path) == alone


def test_the_gravest_exit_code_counts():
    codes = {(): 0, (0, 4): 4, (6, 4): 4, (6, 3, 0): 3, (4, 1, 3): 1}
    for given, expected in codes.items():
        assert exit_code([Outcome(str(code), exit_code=code) for code in given]) == expected


def test_a_plan_that_does_not_arrive_comes_first_in_the_table_and_on_the_page(capsys):
    message = "misses the goal by 3200.0 m after 10.7 h"
    alarm = f"the plan is unreachable: {message}: choose a goal within reach"
    answer = {"status": "done", "by_dive": [], "observations": {"used": 3, "rejected": 0}}
    good, bad = (
        {"status": "reached", "message": "meets the goal"},
        {"status": "unreachable", "message": message},
    )
    outcomes = [
        Outcome("a", {**answer, "plan": good}),
        Outcome("b", {**answer, "plan": bad}),
        Outcome("c", answer),
    ]
    assert [row_of(outcome)["plan_alarm"] for outcome in outcomes] == [
        None,
        alarm,
        None,
    ]
    print_fleet(outcomes, SafeConsole(width=200))
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"ALARM: b: {alarm}"
    assert [line.split()[2:] for line in lines[3:5]] == [
        ["trust", "reached", "3", "0"],
        ["with", "care", "unreachable", "3", "0"],
    ]
    page = fleet_page(outcomes)
    assert page.index(f"b: {alarm}") < page.index("<table>")


def test_names_in_the_page_are_text():
    page = fleet_page([Outcome("<b>", failed="<script>alert(1)</script>")])
    assert "<script>alert(1)" not in page
    assert "&lt;script&gt;alert(1)" in page


@pytest.mark.full
def test_one_process_of_its_own(table, alone, tmp_path):
    done = invoke(f"fleet {table} -o {tmp_path}/out --workers 1")
    assert done.exit_code == 0, done.output
    assert contents(tmp_path / "out") == alone


def test_a_mission_that_ends_with_an_unforeseen_error_has_its_name_and_exit_code_1():
    assert failure("m", ValueError("no number")).failed == "ValueError: no number"
    assert failure("m", ValueError("no number")).exit_code == 1
    assert failure("m", ForecastError("no forecast")).exit_code == ForecastError("").exit_code
