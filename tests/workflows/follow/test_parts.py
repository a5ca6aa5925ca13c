"""What following is made of, each part alone, and the options with which ``replay`` follows logs."""

import hashlib
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from replay_kit.config.run import LogConfig, RunConfig
from replay_kit.core.errors import ConfigError
from replay_kit.core.message import Message
from replay_kit.core.plan import Place
from replay_kit.logs.mcap.writer import write_mcap_log
from replay_kit.results.outcome.verdict import Alarm
from replay_kit.show.status.status import Status
from replay_kit.workflows.follow.watch import (
    Clock,
    Memory,
    Source,
    alarm_line,
    change_words,
    examine,
    judged_file,
    key_of,
    look,
    look_again,
    new_alarms,
    notify,
    read_goal,
    read_memory,
    settled_files,
    standing_alarms,
    with_goal,
    write_memory,
)
from tests.command import invoke
from tests.places import SAMPLES

DAY_NS = 86_400 * 10**9
NOW_NS = 1_700_000_000 * 10**9
STAMP = (1, 2, 100, 4)


def source(name: str, first_ns: int = NOW_NS - DAY_NS, **values: object) -> Source:
    return replace(Source(Path(name), STAMP, f"sha of {name}", "", first_ns), **values)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, ""),
        ({"mission": "sg171 mission 1"}, ""),
        ({"mission": "sg999 mission 2"}, "is of sg999 mission 2, not of sg171 mission 1"),
        ({"first_ns": NOW_NS + 2 * DAY_NS}, "far from the present: its clock was wrong"),
        ({"first_ns": NOW_NS - 500 * DAY_NS}, "far from the others"),
        ({"first_ns": NOW_NS - 300 * DAY_NS}, ""),
    ],
)
def test_a_file_of_another_vehicle_or_of_a_clock_that_jumped_is_set_aside(changes, words):
    own, found = source("a.nc", mission="sg171 mission 1"), source("b.nc", **changes)
    aside = judged_file({own.path: own}, found, NOW_NS).aside
    assert (words in aside, bool(aside)) == (True, bool(words))
    # a file that is not used itself judges no other
    if "mission" in changes:
        unused = {own.path: replace(own, aside="is not a readable log")}
        assert judged_file(unused, found, NOW_NS).aside == ""


def test_files_of_another_mission_are_taken_when_those_that_came_before_them_go(tmp_path):
    fix = "/vehicle/fix", "foxglove.LocationFix", {"longitude": 152.0, "latitude": -40.0}, 0, 0
    for name, day in (("a.mcap", 600), ("b.mcap", 0), ("c.mcap", 1)):
        write_mcap_log(tmp_path / name, [Message(day * DAY_NS, *fix)])
    clock = Clock(now_ns=lambda: NOW_NS, wait=lambda _: None)
    looked, about = partial(look, [tmp_path], []), (RunConfig().logs, clock, 1.0)
    known, said, _ = look_again(looked, {}, *about)
    # nothing was replayed before the first look
    assert said[0] == "a.mcap new"
    assert all("not used: it begins at" in text for text in said[1:])
    assert look_again(looked, known, *about) == (known, [], False)
    (tmp_path / "a.mcap").unlink()
    known, said, changed = look_again(looked, known, *about)
    assert changed
    assert said[1:] == ["b.mcap new", "c.mcap new"]
    assert not any(source.aside for source in known.values())


def test_what_happened_to_a_file_is_told_in_words():
    before = Source(Path("a.mcap"), STAMP, "sha", "", NOW_NS)
    touched = replace(before, stamp=(1, 2, 100, 5))
    assert change_words(before, touched) == ""
    grown = replace(touched, stamp=(1, 2, 150, 5), sha256="other")
    assert change_words(before, grown) == "changed, from 100 to 150 bytes"
    aside = replace(before, aside="is not a readable log")
    assert change_words(aside, aside) == ""


def test_a_file_that_grew_since_it_was_looked_at_is_known_by_the_bytes_it_had(tmp_path):
    path = tmp_path / "log.unknown"
    path.write_bytes(b"first")
    stamp = look([path], [])[path]
    path.write_bytes(b"first and more")
    assert examine(path, stamp, LogConfig()).sha256 == hashlib.sha256(b"first").hexdigest()


def test_files_are_taken_when_they_are_whole_in_the_order_of_a_replay_of_the_folder(tmp_path):
    gliders = ["sea1.2.pld1.sub.9.gz", "sea1.2.pld1.sub.10.gz", "p9.nc", "p10.nc"]
    for name in (*gliders, "b.mcap", ".hidden", "c.mcap.part"):
        (tmp_path / name).write_bytes(b"x")
    (tmp_path / "own.mcap").write_bytes(b"x")
    found = look([tmp_path, tmp_path / "missing.nc"], [tmp_path / "own.mcap"])
    assert [path.name for path in found] == [*gliders, "b.mcap"]
    later = {path: (stamp[0], stamp[1], stamp[2] + 1, stamp[3]) for path, stamp in found.items()}
    assert [path.name for path in settled_files(found, later)] == ["b.mcap"]
    assert settled_files(found, found) == found


def test_the_goal_s_file_is_read_and_a_goal_holds_from_its_time_on(tmp_path):
    path = tmp_path / "goal"
    path.write_text("# where\n\n 152.5 , -40 , 300\n1,2,3\n")
    goal = read_goal(path)
    assert goal == Place(152.5, -40.0, 300.0)
    for text in ("", "1,2,3,4", "0,91,0"):
        path.write_text(text)
        with pytest.raises(ConfigError, match="LON,LAT,DEPTH"):
            read_goal(path)
    first, others = ((0, goal),), [Place(k, 2.0, 3.0) for k in (1.0, 4.0)]
    assert with_goal((), goal, 99) == with_goal(first, goal, 99) == first
    # moved twice before anything new came
    moved = with_goal(first, others[0], 99)
    assert moved == (*first, (99, others[0]))
    assert with_goal(moved, others[1], 99) == (*first, (99, others[1]))


def test_what_is_remembered_is_read_back(tmp_path):
    sources, goals = {Path("a"): source("a", mission="m")}, ((0, Place(1.0, 2.0, 3.0)),)
    memory = Memory(sources, goals, ("said",), ("plan: unsafe",), "f sha256:0", "null")
    assert read_memory(tmp_path) == Memory()
    write_memory(tmp_path, memory)
    assert read_memory(tmp_path) == memory


def test_an_alarm_is_given_once_for_what_it_is_about_and_again_when_it_comes_back():
    alarm = Alarm("plan", "the plan is unsafe: it crosses land", "2018-11-16 00:00:00Z", "unsafe")
    status = Status("r.mcap", NOW_NS, (alarm,), {"result": "r.mcap", "position": {"latitude": 1.0}})
    calm = status._replace(alarms=())
    key, other = key_of(alarm), "surfacing overdue: 1"
    assert (new_alarms(status, ()), new_alarms(status, (key,))) == ((alarm,), ())
    assert (standing_alarms({"": status}, (key,)), standing_alarms({"": calm}, (key, other))) == (
        (key,),
        (other,),
    )
    assert '"latitude": 1.0' in alarm_line(alarm, status)


def test_a_command_gets_its_line_and_its_failure_is_told(tmp_path):
    assert notify(f"cat > '{tmp_path / 'got'}'", "line\n") == ""
    assert (tmp_path / "got").read_text() == "line\n"
    assert notify("echo why >&2; exit 4", "line\n") == "--notify: the command ended with 4: why"


REPLAY = "replay {} --ensemble sample_logs/ensemble.nc -o {}"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("--until-idle 1", "--until-idle: needs --follow"),
        ("--goal-file goal.txt", "--goal-file: needs --follow"),
        ("--notify true", "--notify: needs --follow"),
        ("--follow --dry-run", "--dry-run: cannot be combined"),
        ("--follow --checkpoint c", "--checkpoint: cannot be combined"),
        ("--follow --interval 0", "--interval"),
        ("--follow --goal=152.8,-40.1,300 --goal-file goal.txt", "cannot be combined with --goal"),
        (f"--follow --against {SAMPLES}/truth.nc", "--against: cannot be combined"),
    ],
)
def test_options_that_do_not_go_together_are_refused(options, words, tmp_path):
    done = invoke(f"{REPLAY.format(tmp_path, tmp_path.parent / 'out.mcap')} {options}")
    assert (done.exit_code, words in done.stderr) == (2, True), done.output


def test_a_folder_in_which_no_log_comes_ends_with_exit_code_3_and_what_was_there(tmp_path):
    inbox, out = tmp_path / "inbox", tmp_path / "out.mcap"
    inbox.mkdir()
    (inbox / "notes.txt").write_text("none")
    done = invoke(f"{REPLAY.format(inbox, out)} --follow --interval 0.1 --until-idle 0")
    assert done.exit_code == 3
    assert "notes.txt not used" in done.stdout
    assert "no log that can be replayed has arrived" in done.stderr
    assert not out.exists()
