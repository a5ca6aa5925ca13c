"""What a replay learns of its logs before it begins: where and when what it will use was measured."""

import numpy as np
import pytest

from replay_kit.config.run import load_config
from replay_kit.core.errors import MeasurementError
from replay_kit.core.message import Message
from replay_kit.logs import open_log
from replay_kit.logs.mcap.writer import write_mcap_log
from replay_kit.logs.reader import reading
from replay_kit.workflows.replay.inputs.scan import Logs

NS = 10**9
START = int(np.datetime64("2026-01-01T00:00:00", "ns").astype(np.int64))


def fix(seconds, longitude, latitude, topic="/vehicle/fix"):
    return Message(
        START + int(seconds * NS),
        topic,
        "foxglove.LocationFix",
        {"longitude": longitude, "latitude": latitude},
        0,
        0,
    )


def settings(place=True, **logs):
    return load_config(None, {"forecast": {"place": place}, "logs": logs})


def mean_longitude(*longitudes):
    return np.rad2deg(np.angle(np.exp(1j * np.deg2rad(longitudes)).mean()))


def written(path, messages):
    write_mcap_log(path, [message._replace(position=k) for k, message in enumerate(messages)])
    return path


@pytest.fixture
def log(tmp_path):
    """Four fixes ten seconds apart, and a home position on a topic that comes once, before them."""
    home = fix(-50, 10.0, 50.0, "/vehicle/config")
    return written(
        tmp_path / "log.mcap", [home, *(fix(10 * k, 152.0 + k, -40.0 + 0.5 * k) for k in range(4))]
    )


@pytest.mark.parametrize(
    ("span", "used"),
    [
        ({"start": "2026-01-01T00:00:20Z"}, [2, 3]),
        ({"start": "2026-01-01T00:00:19.999Z", "end": "2026-01-01T00:00:29.999Z"}, [2]),
        ({"start": "2026-01-01T00:00:00Z", "end": "2026-01-01T00:00:10Z"}, [0, 1]),
        ({"start": "2025-12-31T23:59:30Z", "end": "2026-01-01T00:00:00Z"}, [0]),
    ],
)
def test_only_positions_of_the_chosen_span_place_an_ensemble(log, span, used):
    """Not the home position either, although a message that comes once is read where it is older than the span."""
    (longitude, latitude), first_ns = Logs([[log]], settings(**span)).ahead()
    assert longitude == pytest.approx(152.0 + np.mean(used))
    assert latitude == pytest.approx(-40.0 + 0.5 * np.mean(used))
    assert first_ns == settings(**span).logs.start_ns


def test_an_end_alone_leaves_the_beginning_of_the_log(log):
    (longitude, latitude), first_ns = Logs([[log]], settings(end="2026-01-01T00:00:00Z")).ahead()
    assert (longitude, latitude) == pytest.approx((mean_longitude(10.0, 152.0), 5.0))
    assert first_ns == START - 50 * NS


@pytest.mark.parametrize("place", [True, False])
def test_the_first_time_used_is_not_before_the_start(log, place):
    assert Logs([[log]], settings(place)).ahead()[1] == START - 50 * NS
    assert Logs([[log]], settings(place, start="2026-01-01T00:00:05Z")).ahead()[1] == START + 5 * NS


def test_late_messages_are_left_out_as_in_the_replay(tmp_path):
    log = written(
        tmp_path / "log.mcap",
        [fix(0, 152.0, -40.0), fix(10, 153.0, -40.0), fix(20, 154.0, -40.0), fix(5, 170.0, -40.0)],
    )
    whole = mean_longitude(152.0, 153.0, 154.0, 170.0), -40.0
    # in the order of its index none is late
    assert Logs([[log]], settings()).ahead()[0] == pytest.approx(whole)
    log.write_bytes(log.read_bytes()[:-40])
    assert Logs([[log]], settings()).ahead()[0] == pytest.approx((153.0, -40.0))
    assert Logs([[log]], settings(reorder_window=30.0)).ahead()[0] == pytest.approx(whole)


def test_a_span_without_a_position_is_said(log):
    with pytest.raises(
        MeasurementError, match=r"no position between 2026-01-02.*widen --start and --end"
    ):
        Logs([[log]], settings(start="2026-01-02T00:00:00Z")).ahead()


def test_the_share_of_the_logs_that_is_read_grows_to_the_whole(tmp_path):
    messages, told = [fix(k, 0.1, 0.0)._replace(position=k) for k in range(5000)], []
    write_mcap_log(tmp_path / "a.mcap", messages)
    with open_log(tmp_path / "a.mcap") as one, open_log(tmp_path / "a.mcap", 1) as other:
        advance = reading([one, other], lambda *step: told.append(step), "replaying")
        for _ in one.messages():
            advance(1)
    shares = [done for done, _, _ in told]
    assert len(told) == 5000 // 64
    assert {(total, what) for _, total, what in told} == {(2, "replaying")}
    assert shares == sorted(shares)
    # what is not begun counts as read
    assert 1.0 < shares[0] < shares[-1] <= 2.0
