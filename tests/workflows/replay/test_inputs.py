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
    place = {"longitude": longitude, "latitude": latitude}
    return Message(START + int(seconds * NS), topic, "foxglove.LocationFix", place, 0, 0)


def settings(place=True, **logs):
    return load_config(None, {"forecast": {"place": place}, "logs": logs})


def ahead(log, **given):
    """The mean place, and the first time in seconds after the beginning of 2026."""
    at, first_ns = Logs([[log]], settings(**given)).ahead()
    return at, (first_ns - START) / NS


def mean_longitude(*longitudes):
    return np.rad2deg(np.angle(np.exp(1j * np.deg2rad(longitudes)).mean()))


def written(path, messages):
    write_mcap_log(path, [message._replace(position=k) for k, message in enumerate(messages)])
    return path


@pytest.fixture
def log(tmp_path):
    """Four fixes ten seconds apart, and a home position on a topic that comes once, before them."""
    fixes = [fix(10 * k, 152.0 + k, -40.0 + 0.5 * k) for k in range(4)]
    return written(tmp_path / "log.mcap", [fix(-50, 10.0, 50.0, "/vehicle/config"), *fixes])


@pytest.mark.parametrize(
    ("span", "longitude", "latitude", "first"),
    [
        (
            {"start": "2026-01-01T00:00:19.999Z", "end": "2026-01-01T00:00:29.999Z"},
            154.0,
            -39.0,
            19.999,
        ),
        ({"start": "2026-01-01", "end": "2026-01-01T00:00:10Z"}, 152.5, -39.75, 0.0),
        # not the home position either, although a message that comes once is read where it is older than the span
        ({"start": "2025-12-31T23:59:30Z", "end": "2026-01-01"}, 152.0, -40.0, -30.0),
        # an end alone leaves the beginning of the log
        ({"end": "2026-01-01"}, mean_longitude(10.0, 152.0), 5.0, -50.0),
    ],
)
def test_only_positions_of_the_chosen_span_place_an_ensemble(log, span, longitude, latitude, first):
    at, begin = ahead(log, **span)
    assert at == pytest.approx((longitude, latitude))
    assert begin == pytest.approx(first)
    # where nothing is placed it is the same
    assert ahead(log, place=False, **span)[1] == begin
    with pytest.raises(MeasurementError, match=r"no position between 2026-01-02.*widen --start"):
        ahead(log, start="2026-01-02")


def test_radars_alone_place_an_ensemble_at_their_vectors(tmp_path):
    vectors = {name: [0.1, 0.1] for name in ("speed", "direction", "error")}
    vectors |= {"longitude": [151.9, 152.1], "latitude": [-40.0, -40.0], "depth": 2.0}
    vectors["averaged"] = 3600.0
    radar = Message(START, "/radar", "replay_kit.RadarCurrents", vectors, 0, 0)
    at, _ = ahead(written(tmp_path / "log.mcap", [radar]))
    assert at == pytest.approx((152.0, -40.0), abs=0.01)


def test_late_messages_are_left_out_as_in_the_replay(tmp_path):
    longitudes = 152.0, 153.0, 154.0, 170.0
    fixes = [fix(t, x, -40.0) for t, x in zip((0, 10, 20, 5), longitudes, strict=True)]
    log, whole = written(tmp_path / "log.mcap", fixes), (mean_longitude(*longitudes), -40.0)
    # in the order of its index none is late
    assert ahead(log)[0] == pytest.approx(whole)
    log.write_bytes(log.read_bytes()[:-40])
    assert ahead(log)[0] == pytest.approx((153.0, -40.0))
    assert ahead(log, reorder_window=30.0)[0] == pytest.approx(whole)


def test_the_share_of_the_logs_that_is_read_grows_to_the_whole(tmp_path):
    path, told = written(tmp_path / "a.mcap", [fix(k, 0.1, 0.0) for k in range(5000)]), []
    with open_log(path) as one, open_log(path, 1) as other:
        advance = reading([one, other], lambda *step: told.append(step), "replaying")
        for _ in one.messages():
            advance(1)
    shares = [done for done, _, _ in told]
    assert len(told) == 5000 // 64
    assert {step[1:] for step in told} == {(2, "replaying")}
    assert shares == sorted(shares)
    # what is not begun counts as read
    assert 1.0 < shares[0] < shares[-1] <= 2.0
