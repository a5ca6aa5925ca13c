"""Logs that grow, replayed as they come: the answer of one replay of what is there in the end, whatever happened on the way."""

import os
import shutil
from collections.abc import Callable
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


@pytest.fixture
def sea(ocean, tmp_path):
    return Sea(ocean, tmp_path)


def puts(sea, dives):
    return [sea.put(one.name, one.data) for one in dives]


def same(sea: Sea) -> bool:
    """Whether a result has the messages and the attachments of one replay of the files that are there in the end."""
    return contents(sea.out) == contents(sea.at_once())


def test_dives_out_of_order_and_one_corrected_give_the_bytes_of_one_replay(ocean, sea, dives):
    # the end of it did not come through at first
    cut = Instalment(dives[2].name, dives[2].data[: 2 * len(dives[2].data) // 3])
    with mock.patch.object(following, "build", wraps=following.build) as built:
        summary = sea.follow(puts(sea, delivered(dives, [1], 2, cut)))
    # once for all replays with a forecast
    assert sum("replayed in" in text for text in sea.told) > 1 == built.call_count
    assert same(sea)
    by_dive = summary.by_dive
    assert [row["dive"] for row in by_dive] == list(range(1, len(by_dive) + 1))
    assert sum(row["profiles"] for row in by_dive) <= summary.observations["used"]
    rms = [by_dive[0][f"rms_innovation_{kind}"] for kind in ("predicted", "prior")]
    assert rms[0] <= rms[1] * (1 + 1e-12)
    # of a chunk that is cut nothing is read
    assert any(text.startswith("dive003.mcap not used: it has no message yet") for text in sea.told)
    assert any(text.startswith("dive003.mcap new") for text in sea.told)
    assert sea.options.status.is_file()
    assert verify(sea.out, [sea.inbox, ocean], planner_of).same


def messages_of(replay: Callable[[], object]) -> int:
    """The number of messages that a replay takes."""
    with mock.patch.object(running, "measure_messages", wraps=running.measure_messages) as taken:
        replay()
    return sum(len(call.args[1]) for call in taken.call_args_list)


def test_what_did_not_change_is_not_replayed_again_nor_for_a_second_file_of_a_dive(
    sea, dives, tmp_path
):
    for put in puts(sea, dives[:-1]):
        put()
    sea.follow()
    (tmp_path / "last.mcap").write_bytes(dives[-1].data)
    messages = [*open_log(tmp_path / "last.mcap").messages()]
    taken = []
    for name, pings in (("flight.mcap", False), ("science.mcap", True)):
        own = [one for one in messages if (one.schema == "replay_kit.AdcpPing") == pings]
        write_mcap_log(sea.inbox / name, own)
        taken.append(messages_of(sea.follow))
    whole = messages_of(sea.at_once)
    # the last block of observations before the new dive was not complete
    assert all(0 < each < whole // 2 for each in taken)
    assert contents(sea.out) == contents(tmp_path / "at-once.mcap")


def test_what_is_said_of_a_file_outlives_a_kill_as_soon_as_the_file_is_known(sea, dives):
    puts(sea, dives)[0]()

    def killed(*given: object) -> None:
        write_memory(*given)
        raise Killed

    with mock.patch.object(following, "write_memory", killed), pytest.raises(Killed):
        sea.follow()
    left = read_memory(sea.options.states)
    assert [path.name for path in left.sources] == [dives[0].name]
    assert [text.split()[0] for text in left.said] == [dives[0].name]


@pytest.mark.full
@pytest.mark.parametrize("name", ["glider.mcap", "glider.tlog"])
def test_a_growing_log_is_replayed_up_to_what_is_whole(name, tmp_path):
    data, sea = (SAMPLES / name).read_bytes(), Sea(SAMPLES, tmp_path)
    sea.follow([sea.put(name, data[: k * len(data) // 4]) for k in (2, 3, 4)])
    assert same(sea)
    assert sum("changed, from" in text for text in sea.told) >= 1
    assert sum("replayed in" in text for text in sea.told) >= 2


def test_what_does_not_belong_is_told_and_left_out(sea, dives):
    first, second, *_ = puts(sea, dives)
    others = {"notes.txt": b"pilot's notes", "copy.mcap": dives[0].data, "empty.mcap": b""}
    sea.follow([first, *(sea.put(*other) for other in others.items()), second])
    words = "\n".join(sea.told)
    assert "notes.txt not used: it is not a readable log" in words
    assert "copy.mcap not used: it is identical to dive001.mcap" in words
    assert "empty.mcap not used: it is not a readable log" in words
    for name in others:
        (sea.inbox / name).unlink()
    assert same(sea)


@pytest.mark.full
def test_a_file_that_goes_is_told_and_the_replay_goes_back(sea, dives):
    gone = (sea.inbox / dives[1].name).unlink
    sea.follow([*puts(sea, dives)[:2], *[lambda: None] * 2, gone])
    assert any("dive002.mcap: missing" in text for text in sea.told)
    assert same(sea)


@pytest.mark.full
def test_a_goal_that_moves_is_taken_at_once_and_earlier_plans_keep_theirs(sea, dives, tmp_path):
    file = tmp_path / "goal.txt"
    file.write_text("# first\n152.3,-39.8,150\n")
    first, second, third, *_ = puts(sea, dives)
    first()
    second()
    moved, nowhere = (
        lambda text=text: file.write_text(text) for text in ("152.2,-39.7,100\n", "nowhere\n")
    )
    sea.follow([moved, nowhere, third], goal_file=file)
    goals = [(place.longitude, place.depth) for _, place in read_memory(sea.options.states).goals]
    assert goals == [(152.3, 150.0), (152.2, 100.0)]
    assert any("the goal moved to 152.2000 E" in text for text in sea.told)
    assert any("LON,LAT,DEPTH" in text and "the goal is unchanged" in text for text in sea.told)
    planned = open_result(sea.out).plans
    assert planned["goal_longitude"].iloc[[0, -1]].tolist() == [152.3, 152.2]


@pytest.mark.full
@pytest.mark.parametrize("usable", [True, False])
def test_a_newer_forecast_is_taken_with_the_next_dive_if_it_can_be_used(
    ocean, sea, dives, tmp_path, usable
):
    forecast, newer = tmp_path / "forecast.nc", tmp_path / "newer.nc"
    shutil.copy(ocean / "ensemble.nc", forecast)
    sea.job = ReplayJob((sea.inbox,), forecast, sea.out)
    first, second, *_ = puts(sea, dives)
    first()
    if usable:
        synthetic.dataset(seed=9, n_members=12, shape=(6, 7)).to_netcdf(newer, engine="h5netcdf")
    else:
        newer.write_bytes(b"cut off")
    sea.follow([lambda: os.replace(newer, forecast), lambda: None, second])
    told = "a newer forecast: forecast.nc sha256:" if usable else "the previous one is kept"
    (at,) = (k for k, text in enumerate(sea.told) if "newer forecast" in text)
    assert told in sea.told[at]
    # nothing is said of it before something is replayed
    assert any("dive002.mcap new" in text for text in sea.told[:at])
    if not usable:
        shutil.copy(ocean / "ensemble.nc", forecast)
    assert same(sea)


def test_a_forecast_that_cannot_be_read_ends_the_beginning_with_its_error(sea, dives, tmp_path):
    puts(sea, dives)[0]()
    sea.job = ReplayJob((sea.inbox,), tmp_path / "none.nc", sea.out)
    with pytest.raises(ForecastError):
        sea.follow()
