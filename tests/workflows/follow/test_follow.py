"""Logs that grow, replayed as they come: the answer of one replay of what is there in the end, whatever happened on the way."""

import json
import os
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from unittest import mock

import pytest

from replay_kit import open_result
from replay_kit.core.errors import ForecastError
from replay_kit.logs import open_log
from replay_kit.logs.mcap.writer import write_mcap_log
from replay_kit.workflows.follow import follow as following
from replay_kit.workflows.follow.watch import read_memory, write_memory
from replay_kit.workflows.planning.adapters import planner_of
from replay_kit.workflows.replay import run as running
from replay_kit.workflows.replay.inputs.job import ReplayJob
from replay_kit.workflows.verify import verify
from tests import synthetic
from tests.instalments import Instalment, delivered, dives_of
from tests.places import SAMPLES
from tests.workflows.follow.delivery import Sea, contents
from tests.workflows.replay.interrupted import Killed


@pytest.fixture(scope="module")
def dives(ocean, tmp_path_factory) -> list[Instalment]:
    return dives_of(ocean / "glider.mcap", tmp_path_factory.mktemp("dives"))


def cut(dive: Instalment) -> Instalment:
    """A dive of which the end did not come through."""
    return Instalment(dive.name, dive.data[: 2 * len(dive.data) // 3])


def same(sea: Sea, tmp_path: Path) -> bool:
    """Whether a result has the messages and the attachments of one replay of the files that are there in the end."""
    return contents(sea.out) == contents(sea.at_once(tmp_path / "at-once.mcap"))


def test_dives_out_of_order_and_one_corrected_give_the_bytes_of_one_replay(ocean, dives, tmp_path):
    sea = Sea(ocean, tmp_path, goal=None)
    arrive = delivered(dives, [1], 2, cut(dives[2]))
    with mock.patch.object(following, "build", wraps=following.build) as built:
        summary = sea.follow([sea.put(one.name, one.data) for one in arrive])
    # once for all replays with a forecast
    assert sum("replayed in" in text for text in sea.told) > 1 == built.call_count
    assert same(sea, tmp_path)
    assert [row["dive"] for row in summary.by_dive] == list(range(1, len(summary.by_dive) + 1))
    # of a chunk that is cut nothing is read
    assert any(text.startswith("dive003.mcap not used: it has no message yet") for text in sea.told)
    assert any(text.startswith("dive003.mcap new, older than replayed data") for text in sea.told)
    assert sea.options.status.is_file()
    assert not (sea.out.with_name("result.mcap.part")).exists()
    assert verify(sea.out, [sea.inbox, ocean], planner_of).same


def messages_of(replay: Callable[[], object]) -> int:
    """The number of messages that a replay takes."""
    with mock.patch.object(running, "taken", wraps=running.taken) as taken:
        replay()
    return sum(len(call.args[1]) for call in taken.call_args_list)


def test_what_did_not_change_is_not_replayed_again_nor_for_a_second_file_of_a_dive(
    ocean, dives, tmp_path
):
    sea = Sea(ocean, tmp_path, goal=None)
    for one in dives[:-1]:
        sea.put(one.name, one.data)()
    sea.follow()
    (tmp_path / "last.mcap").write_bytes(dives[-1].data)
    messages = [*open_log(tmp_path / "last.mcap").messages()]
    taken = []
    for name, pings in (("flight.mcap", False), ("science.mcap", True)):
        own = [one for one in messages if (one.schema == "replay_kit.AdcpPing") == pings]
        write_mcap_log(sea.inbox / name, own)
        taken.append(messages_of(sea.follow))
    whole = messages_of(lambda: sea.at_once(tmp_path / "at-once.mcap"))
    # the last block of observations before the new dive was not complete
    assert all(0 < each < whole // 2 for each in taken)
    assert contents(sea.out) == contents(tmp_path / "at-once.mcap")


def test_what_is_said_of_a_file_outlives_a_kill_as_soon_as_the_file_is_known(
    ocean, dives, tmp_path
):
    sea = Sea(ocean, tmp_path, goal=None)
    sea.put(dives[0].name, dives[0].data)()

    def killed(*given: object) -> None:
        write_memory(*given)
        raise Killed

    with (
        mock.patch("replay_kit.workflows.follow.follow.write_memory", side_effect=killed),
        pytest.raises(Killed),
    ):
        sea.follow()
    left = read_memory(sea.options.states)
    assert [path.name for path in left.sources] == [dives[0].name]
    assert [text.split()[0] for text in left.said] == [dives[0].name]


@pytest.mark.full
def test_an_interrupt_leaves_whole_files_alone(ocean, dives, tmp_path):
    sea = Sea(ocean, tmp_path)
    sea.put(dives[0].name, dives[0].data)()
    sea.follow()
    before = sea.out.read_bytes()
    sea.put(dives[1].name, dives[1].data)()
    with (
        mock.patch("replay_kit.workflows.replay.replay.conclude", side_effect=KeyboardInterrupt),
        pytest.raises(KeyboardInterrupt),
    ):
        sea.follow()
    assert sea.out.read_bytes() == before
    assert {path.name for path in tmp_path.iterdir()} == {
        "inbox",
        "result.mcap",
        "states",
        "status.html",
    }


@pytest.mark.full
@pytest.mark.parametrize("name", ["glider.mcap", "glider.tlog"])
def test_a_growing_log_is_replayed_up_to_what_is_whole(name, tmp_path):
    data = (SAMPLES / name).read_bytes()
    sea = Sea(SAMPLES, tmp_path, goal=None)
    sea.follow([sea.put(name, data[: k * len(data) // 4]) for k in (2, 3, 4)])
    assert same(sea, tmp_path)
    assert sum("grew from" in text for text in sea.told) >= 1
    assert sum("replayed in" in text for text in sea.told) >= 2


def test_what_does_not_belong_is_told_and_left_out(ocean, dives, tmp_path):
    sea = Sea(ocean, tmp_path, goal=None)
    first, second = dives[0], dives[1]
    arrive = [
        sea.put(first.name, first.data),
        sea.put("notes.txt", b"pilot's notes"),
        sea.put("copy.mcap", first.data),
        sea.put("empty.mcap", b""),
        sea.put(second.name, second.data),
    ]
    sea.follow(arrive)
    words = "\n".join(sea.told)
    assert "notes.txt not used: it is not a readable log" in words
    assert "copy.mcap not used: it is identical to dive001.mcap" in words
    assert "empty.mcap not used: it is not a readable log" in words
    for path in sea.inbox.iterdir():
        if not path.name.startswith("dive"):
            path.unlink()
    assert same(sea, tmp_path)


@pytest.mark.full
def test_a_file_that_goes_is_told_and_the_replay_goes_back(ocean, dives, tmp_path):
    sea = Sea(ocean, tmp_path, goal=None)
    arrive = [sea.put(one.name, one.data) for one in dives[:2]]
    sea.follow([*arrive, *[lambda: None] * 2, (sea.inbox / dives[1].name).unlink])
    assert any("dive002.mcap: missing" in text for text in sea.told)
    assert same(sea, tmp_path)


@pytest.mark.full
def test_a_goal_that_moves_is_taken_at_once_and_earlier_plans_keep_theirs(ocean, dives, tmp_path):
    sea = Sea(ocean, tmp_path, goal=None)
    file = tmp_path / "goal.txt"
    file.write_text("# first\n152.3,-39.8,150\n")
    for one in dives[:2]:
        sea.put(one.name, one.data)()
    deliveries = [
        lambda: file.write_text("152.2,-39.7,100\n"),
        lambda: file.write_text("nowhere\n"),
        sea.put(dives[2].name, dives[2].data),
    ]
    sea.follow(deliveries, goal_file=file)
    goals = read_memory(sea.options.states).goals
    assert [(place.longitude, place.depth) for _, place in goals] == [
        (152.3, 150.0),
        (152.2, 100.0),
    ]
    assert any("the goal moved to 152.2000 E" in text for text in sea.told)
    assert any(
        "expected LON,LAT,DEPTH" in text and "the goal is unchanged" in text for text in sea.told
    )
    planned = open_result(sea.out).plans
    assert planned["goal_longitude"].iloc[[0, -1]].tolist() == [152.3, 152.2]


@pytest.fixture
def forecast_of_its_own(ocean, dives, tmp_path):
    """A vehicle with its first dive, and the file of a forecast that may become another one."""
    sea, forecast = Sea(ocean, tmp_path, goal=None), tmp_path / "forecast.nc"
    shutil.copy(ocean / "ensemble.nc", forecast)
    sea.job = ReplayJob((sea.inbox,), forecast, sea.out)
    sea.put(dives[0].name, dives[0].data)()
    return sea, forecast


@pytest.mark.full
def test_a_newer_forecast_is_taken_with_the_next_dive(forecast_of_its_own, dives, tmp_path):
    sea, forecast = forecast_of_its_own
    newer = tmp_path / "newer.nc"
    synthetic.dataset(seed=9, n_members=12, shape=(6, 7)).to_netcdf(newer, engine="h5netcdf")
    sea.follow([lambda: os.replace(newer, forecast)])
    assert not any("newer forecast" in text for text in sea.told)
    sea.follow([sea.put(dives[1].name, dives[1].data)])
    assert any("a newer forecast: forecast.nc sha256:" in text for text in sea.told)
    assert same(sea, tmp_path)


@pytest.mark.full
def test_a_newer_forecast_that_cannot_be_used_is_told_and_the_one_before_stays(
    ocean, forecast_of_its_own, dives, tmp_path
):
    sea, forecast = forecast_of_its_own
    sea.follow([lambda: forecast.write_bytes(b"cut off"), sea.put(dives[1].name, dives[1].data)])
    assert any(
        "the newer forecast cannot be used, the previous one is kept" in text for text in sea.told
    )
    shutil.copy(ocean / "ensemble.nc", forecast)
    assert same(sea, tmp_path)


def test_a_forecast_that_cannot_be_read_ends_the_beginning_with_its_error(ocean, dives, tmp_path):
    sea = Sea(ocean, tmp_path, goal=None)
    sea.put(dives[0].name, dives[0].data)()
    sea.job = ReplayJob((sea.inbox,), tmp_path / "none.nc", sea.out)
    with pytest.raises(ForecastError):
        sea.follow()


@pytest.mark.full
def test_each_alarm_is_given_once_to_the_command_also_after_a_restart(ocean, dives, tmp_path):
    sea = Sea(ocean, tmp_path)
    got = tmp_path / "alarms.jsonl"
    command = f'{sys.executable} -c \'import sys; open("{got}", "a").write(sys.stdin.read())\''
    sea.put(dives[0].name, dives[0].data)()
    with mock.patch.dict("replay_kit.results.outcome.verdict._ACTIONS", {"reached": "stop"}):
        sea.follow(command=command)
        sea.follow(command=command)
    (line,) = got.read_text().splitlines()
    assert json.loads(line)["kind"] == "plan"
    assert json.loads(line)["position"]["latitude"] < 0.0
