"""Many missions: the bytes of each are those of a replay on its own; what is done is kept, what fails is listed, and the rest goes on."""

import csv
import json
import shutil
import sys
from dataclasses import replace

import pytest

from replay_kit.show.text import SafeConsole
from replay_kit.workflows.fleet import cluster as clusters
from replay_kit.workflows.fleet.page import exit_code, fleet_page, print_fleet, row_of
from replay_kit.workflows.fleet.run import Outcome, failed_mission, run_fleet, run_mission
from replay_kit.workflows.planning.adapters import planner_of
from replay_kit.workflows.replay.inputs.job import Vehicle
from replay_kit.workflows.replay.replay import replay
from tests.command import invoke, succeed
from tests.workflows.disk import full_disk
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


def last(missions, cluster, again=False):
    return list(run_fleet(missions, cluster, again))[-1]


def test_a_fleet_gives_the_bytes_of_its_missions_one_by_one(table, alone, cluster, tmp_path):
    missions = missions_in(table, tmp_path)
    outcomes = last(missions, cluster)
    assert [outcome.name for outcome in outcomes] == ["twin00", "twin01"]
    assert not any(outcome.failed or outcome.kept for outcome in outcomes)
    assert contents(tmp_path) == alone
    records = {path.with_suffix(".json").name for path in tmp_path.glob("*.mcap")}
    assert {path.name for path in tmp_path.iterdir()} == records | set(alone)


def test_the_vehicles_of_a_sea_share_an_estimate_as_in_a_replay_of_them(table, tmp_path):
    sea = table.parent / "sea.toml"
    vehicles = {"a": "twin00.mcap", "b": "twin01.mcap"}
    entry = "".join(f'vehicles.{name} = "{log}"\n' for name, log in vehicles.items())
    sea.write_text(table.read_text().replace('each = "twin*.mcap"\n', entry))
    (mission,) = missions_in(sea, tmp_path)
    outcome = run_mission(mission)
    assert (mission.name, outcome.failed) == ("a-b", "")
    assert set(outcome.answer["vehicles"]) == set(vehicles)
    named = tuple(Vehicle(name, (table.parent / log,)) for name, log in vehicles.items())
    job = replace(mission.job, out=tmp_path / "own.mcap", vehicles=named)
    replay(job, mission.config, planner_of)
    assert job.out.read_bytes() == mission.result.read_bytes()
    assert run_mission(mission).kept
    renamed = replace(mission.job, vehicles=(replace(named[0], name="c"), named[1]))
    assert not run_mission(replace(mission, job=renamed)).kept


def test_what_is_done_is_not_done_again_unless_its_inputs_or_its_result_are_other_ones(
    table, cluster, tmp_path
):
    folder = shutil.copytree(table.parent, tmp_path / "data")
    missions = missions_in(folder / table.name, tmp_path / "out")

    def kept(again=False):
        outcomes = last(missions, cluster, again)
        return [one.kept for one in outcomes], [one.sha256 for one in outcomes]

    first = kept()[1]
    assert kept() == ([True, True], first)
    missions[0].result.write_bytes(b"something else")
    assert kept() == ([False, True], first)
    # a record in which a number was changed is not believed
    record = missions[1].record.read_text()
    assert '"exit_code": 0' in record
    missions[1].record.write_text(record.replace('"exit_code": 0', '"exit_code": 4'))
    assert kept() == ([True, False], first)
    shutil.copy(folder / "twin00.mcap", folder / "twin01.mcap")
    done, changed = kept()
    assert (done, changed[1] != first[1]) == ([True, False], True)
    assert kept(again=True)[0] == [False, False]
    # another forecast of the same name is read
    shutil.copy(folder / "truth.nc", folder / "ensemble.nc")
    assert kept() == ([False, False], ["", ""])


def test_a_mission_that_fails_is_listed_with_its_reason_and_the_others_go_on(
    table, tmp_path, scheduler
):
    folder, out = shutil.copytree(table.parent, tmp_path / "data"), tmp_path / "out"
    (folder / "twin02.mcap").write_bytes(b"no log")
    line = f"fleet {folder}/fleet.toml -o {out} --scheduler {scheduler}"
    done = invoke(f"{line} --json {tmp_path}/fleet.json")
    assert done.exit_code == 3, done.output
    assert "3 missions: 2 replayed, 0 were there already, 1 failed" in done.stdout
    assert "FAILED: twin02: " in done.stdout
    rows = list(csv.DictReader((out / "fleet.csv").read_text().splitlines()))
    assert [row["status"] for row in rows] == ["done", "done", "failed"]
    assert 0.0 < float(rows[0]["rms_after_m_s"]) < float(rows[0]["rms_before_m_s"])
    assert float(rows[0]["truth_rmse_m_s"]) > 0.0
    assert "twin02.mcap" in rows[2]["failed"]
    answer = json.loads((tmp_path / "fleet.json").read_text())
    assert answer["failed"] == ["twin02"]
    assert [row["sha256"] for row in answer["missions"]] == [row["sha256"] for row in rows]
    assert "<li>twin02: " in (out / "index.html").read_text()
    assert invoke(line).exit_code == 2
    assert "2 were there already" in invoke(f"{line} --resume").stdout


def test_a_dry_run_reads_everything_and_writes_nothing_without_the_extra(
    table, tmp_path, monkeypatch
):
    # as where it is not installed
    for name in ("dask", "distributed"):
        monkeypatch.setitem(sys.modules, name, None)
    # without a table logs are missions of their own
    folder = table.parent
    line = f"fleet {folder}/twin*.mcap --ensemble {folder}/ensemble.nc -o {tmp_path}/out"
    answer = json.loads(invoke(f"{line} --workers 1 --dry-run --json -").stdout)
    assert (answer["status"], answer["exit_code"], answer["workers"]) == ("dry run", 0, 1)
    assert [mission["profiles"] for mission in answer["missions"]] == [6, 6]
    assert answer["seconds"] > 0.0
    refused = invoke(f"{line} --scheduler tcp://127.0.0.1:1")
    assert (refused.exit_code, "pip install 'replay-kit[fleet]'" in refused.output) == (2, True)
    assert not (tmp_path / "out").exists()


def test_on_a_full_disk_a_mission_fails_in_words_and_leaves_nothing_half_done(
    table, alone, tmp_path
):
    missions = missions_in(table, tmp_path)
    run_mission(missions[1])
    with full_disk(3000):
        outcome = run_mission(missions[0])
    assert ("is the disk full?" in outcome.failed, outcome.exit_code) == (True, 1)
    assert sorted(path.name for path in tmp_path.glob("twin*")) == ["twin01.json", "twin01.mcap"]
    assert run_mission(missions[1]).kept
    assert not run_mission(missions[0]).failed
    assert contents(tmp_path) == alone


def test_the_gravest_exit_code_counts_and_an_unforeseen_error_is_1():
    for given, expected in {(): 0, (0, 4): 4, (6, 4): 4, (6, 3, 0): 3, (4, 1, 3): 1}.items():
        assert exit_code([Outcome(str(code), exit_code=code) for code in given]) == expected
    unforeseen = failed_mission("m", ValueError("no number"))
    assert (unforeseen.failed, unforeseen.exit_code) == ("ValueError: no number", 1)


def test_a_plan_that_does_not_arrive_comes_first_in_the_table_and_on_the_page(capsys):
    message = "misses the goal by 3200.0 m after 10.7 h"
    alarm = f"the plan is unreachable: {message}: choose a goal within reach"
    answer = {"status": "done", "by_dive": [], "observations": {"used": 3, "rejected": 0}}
    lost = answer | {"by_dive": [{}], "plan": {"status": "unreachable", "message": message}}
    outcomes = [
        Outcome("a", answer | {"plan": {"status": "reached", "message": "meets the goal"}}),
        Outcome("b", lost),
        # each vehicle has dives and a plan of its own
        Outcome("c", answer | {"vehicles": {"g": lost}}),
    ]
    told = [[row_of(one)[name] for name in ("plan", "plan_alarm", "dives")] for one in outcomes]
    assert told == [
        ["reached", None, 0],
        ["unreachable", alarm, 1],
        ["g: unreachable", f"g: {alarm}", 1],
    ]
    print_fleet(outcomes, SafeConsole(width=200))
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"ALARM: b: {alarm}"
    assert [line.split() for line in lines[-4:-2]] == [
        ["a", "3", "reached", "trust"],
        ["b", "3", "unreachable", "with", "care"],
    ]
    page = fleet_page([*outcomes, Outcome("<b>", failed="<script>alert(1)</script>")])
    assert page.index(f"b: {alarm}") < page.index("<table>")
    # names in the page are text
    assert "<script>alert(1)" not in page
    assert "&lt;script&gt;alert(1)" in page


@pytest.mark.full
def test_one_process_of_its_own(table, alone, tmp_path):
    succeed(f"fleet {table} -o {tmp_path}/out --workers 1")
    assert contents(tmp_path / "out") == alone


GOOD = '[all]\nensemble = "ensemble.nc"\n'
M = "[[mission]]\n"
ONE = f'{M}logs = "twin00.mcap"\n'


@pytest.mark.parametrize(
    ("text", "code", "said"),
    [
        (GOOD, 2, "'mission': Field required"),
        (GOOD + M, 2, "mission 1: expected one of logs, vehicles and each"),
        (f'{GOOD}{M}vehicles.a = "twin00.mcap"\n', 2, "at least 2 items"),
        (f'{GOOD}{ONE}each = "*.mcap"\n', 2, "mission 1: expected one of logs, vehicles"),
        (f'{GOOD}{M}each = "*.mcap"\nname = "a"\n', 2, "leave name a out"),
        (f'{GOOD}{ONE}{ONE}name = "TWIN00"\n', 2, "TWIN00: two missions have this name"),
        (f'{GOOD}{ONE}name = "../up"\n', 2, "'mission.0.name'"),
        (f'{GOOD}{M}logs = "none.mcap"\n', 2, "none.mcap: file not found"),
        (f'{GOOD}{M}each = ["a*.no", "twin00.mcap"]\n', 3, "a*.no: no log has such a name"),
        (f'[all]\nensemble = "none.nc"\n{ONE}', 2, "twin00: cannot begin: "),
        (f'{GOOD}{ONE}truth = "none.nc"\n', 2, "none.nc: file not found"),
        (f'[all]\nensemble = "none*.nc"\n{ONE}', 2, "none*.nc"),
        (ONE, 2, "twin00: no ensemble is given"),
        (f"{GOOD}{ONE}settings.estimator.mode = 3\n", 2, "unknown key 'estimator.mode'"),
        (f"{GOOD}{ONE}speed = 3\n", 2, "unknown key 'mission.0.speed'; known here: "),
        (f'[all]\nname = "a"\n{ONE}', 2, "[all] has no name, logs, vehicles or each"),
    ],
)
def test_a_table_that_cannot_be_run_is_refused(table, tmp_path, text, code, said):
    bad = table.parent / "bad.toml"
    bad.write_text(text)
    done = invoke(f"fleet {bad} -o {tmp_path}/out --scheduler tcp://127.0.0.1:1")
    assert (done.exit_code, said in done.stderr) == (code, True), done.output
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("fleet.toml --ensemble ensemble.nc", "fleet.toml names the ensembles"),
        ("twin00.mcap", "expected a table (TOML), or logs with --ensemble FILE"),
        ("fleet.toml --scheduler tcp://127.0.0.1:1 --workers 2", "omit --workers"),
        ("fleet.toml --scheduler nowhere", "the scheduler does not answer in 0.3 s"),
        ("fleet.toml --scheduler tcp://127.0.0.1:1", "the scheduler does not answer in 0.3 s"),
    ],
)
def test_options_that_do_not_fit(table, tmp_path, words, said, monkeypatch):
    monkeypatch.setattr(clusters, "TIMEOUT_S", 0.3)
    monkeypatch.chdir(table.parent)
    done = invoke(f"fleet {words} -o {tmp_path}/out")
    assert said in done.stderr, done.output
