"""The clocks of a telemetry log: the recorder's compared with UTC, the senders' fitted, and one asked for by ``--clock``."""

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from replay_kit.config.run import LogConfig
from replay_kit.core.errors import LogError
from replay_kit.logs import open_log
from tests.logs.log_samples import SHARED, attitude, tlog_entry
from tests.logs.log_samples import read_log as read
from tests.places import needs

START = 1_700_000_000_000_000
SMALL = SHARED / "ardusub" / "small.tlog"
POSITION = frozenset({"GLOBAL_POSITION_INT"})


def system_time(stamp_us, utc_us, boot_ms, version=2):
    message = dialect.MAVLink_system_time_message(utc_us, boot_ms)
    return tlog_entry(stamp_us, message, version=version)


def position(stamp_us, system):
    message = dialect.MAVLink_global_position_int_message(
        1000, 473000000, -1246305732, 0, -1500, 0, 0, 0, 65535
    )
    return tlog_entry(stamp_us, message, system=system)


def late_recorder(n, starts=1):
    """A recorder three seconds late, with jitter; UTC in every tenth message only, one of them an hour wrong; two starts of the vehicle."""
    entries = []
    for start in range(starts):
        for k in range(n):
            utc = START + 1_000_000 * (k + start * n)
            jitter = 1000 * (7 * k % 50)
            stated = 0 if k % 10 else utc + 3_600_000_000 * (k == 50)
            entries += [
                system_time(utc + 3_000_000 + jitter, stated, 5000 + 1000 * k, version=1 + k % 2),
                tlog_entry(utc + 3_000_000 + jitter, attitude(5000 + 1000 * k)),
            ]
    return b"".join(entries)


def test_stamps_stay_unless_asked_and_the_report_says_how_far_off_they_are(tmp_path):
    messages, report = read(tmp_path, late_recorder(100))
    assert messages[2].time_ns == (START + 4_000_000 + 7000) * 1000
    assert "the recorder's stamps are +3." in report.notes[0]
    assert "by 10 of 100 SYSTEM_TIME messages" in report.notes[0]
    assert "against UTC: 10 pairs, 1 outliers, residual 0.0 ms" in report.notes[1]


@pytest.mark.parametrize("starts", [1, 2])
def test_the_clock_of_the_header_is_utc_by_the_time_since_start(tmp_path, starts):
    messages, report = read(tmp_path, late_recorder(100, starts), LogConfig(clock="header"))
    attitudes = [m.time_ns for m in messages if m.schema == "ATTITUDE"]
    assert attitudes == [(START + 1_000_000 * k) * 1000 for k in range(100 * starts)]
    assert report.without_stamp == 0
    assert len(report.notes) == 1 + starts


def test_without_utc_the_clock_of_the_header_smooths_the_stamps(tmp_path):
    jitter = np.random.default_rng(0).exponential(20_000.0, 200).astype(int).tolist()
    entries = (
        system_time(START + 1_000_000 * k + late, 0, 5000 + 1000 * k)
        for k, late in enumerate(jitter)
    )
    messages, report = read(tmp_path, b"".join(entries), LogConfig(clock="header"))
    assert {*np.diff([m.time_ns for m in messages]).tolist()} == {1_000_000_000}
    assert abs(messages[0].time_ns - START * 1000) < 30_000_000
    assert report.notes[0].startswith("none of 200 SYSTEM_TIME messages has UTC")
    assert "against the recorder's stamps: 200 pairs" in report.notes[1]


def test_messages_that_state_no_time_keep_the_recorders(tmp_path):
    array = dialect.MAVLink_debug_float_array_message(START - 5, b"ADCP_E", 1, [0.0] * 58)
    text = dialect.MAVLink_statustext_message(6, b"hello")
    last = [(text, 1), (attitude(1), 9), (array, 1)]
    data = late_recorder(20) + b"".join(tlog_entry(START + 9, m, system=of) for m, of in last)
    messages, report = read(tmp_path, data, LogConfig(clock="header"))
    assert [m.time_ns // 1000 - START for m in messages[-3:]] == [9, 9, -5]
    assert report.without_stamp == 2


def test_positions_of_several_systems_need_a_choice(tmp_path):
    data = b"".join(position(START + n, 1 + n % 2) for n in range(6))
    with pytest.raises(LogError, match=r"set system in \[logs\] to one of 1, 2"):
        read(tmp_path, data, wanted=POSITION)
    messages, report = read(tmp_path, data, LogConfig(system=2), POSITION)
    topics = [f"mavlink/{system}/1/GLOBAL_POSITION_INT" for system in (1, 2)]
    assert {m.topic for m in messages} == {topics[1]}
    assert report.read == dict.fromkeys(topics, 3)
    messages, report = read(tmp_path, data, LogConfig(system=3), POSITION)
    assert messages == []
    assert "no messages of system 3, which [logs] chooses; it holds those of 1, 2" in report.notes
    messages, report = read(tmp_path, data)
    assert len(messages) == 6
    assert report.notes[0].startswith("positions of several systems; a replay needs one")


@needs(SMALL)
def test_a_real_log():
    reader = open_log(SMALL, wanted=POSITION)
    list(reader.messages())
    assert reader.report().notes == (
        "the recorder's stamps are +0.001 s from UTC by 2 of 794 SYSTEM_TIME messages (+0.001 to +0.001 s)",
        "clock of 1/1 since its start against the recorder's stamps: 792 pairs, 8 outliers, residual 6.6 ms",
    )
