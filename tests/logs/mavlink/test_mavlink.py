"""Telemetry logs: as pymavlink's own reader gives them, and what is bad is counted and stepped over."""

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as dialect

from replay_kit.logs import open_log
from tests.logs.log_samples import SHARED, attitude, read_log, tlog, tlog_entry
from tests.logs.mavlink.telemetry_samples import write_tlog
from tests.places import SAMPLES, needs

START = 1_700_000_000_000_000
SMALL = SHARED / "ardusub" / "small.tlog"


def assert_as_pymavlink(path, count):
    """Compare messages with those of pymavlink's reader, so many of them, and return all and the report."""
    reader = open_log(path)
    ours = list(reader.messages())
    assert [m.position for m in ours] == list(range(len(ours)))
    link = mavutil.mavlink_connection(str(path), dialect="ardupilotmega", zero_time_base=False)
    for mine in ours[:count]:
        while (theirs := link.recv_match()).get_type() == "BAD_DATA":
            pass
        expected = theirs.to_dict()
        assert expected.pop("mavpackettype") == mine.schema
        assert repr(dict(mine.payload)) == repr(expected)
        sender = theirs.get_srcSystem(), theirs.get_srcComponent()
        assert mine.topic == "mavlink/{}/{}/{}".format(*sender, theirs.get_type())
        assert mine.time_ns == pytest.approx(theirs._timestamp * 1e9, abs=1500)
    link.close()
    return ours, reader.report()


@pytest.mark.parametrize("entries", [tlog(10)[::2], tlog(10)[1::2], "signed"])
def test_each_version_and_a_signed_frame_as_pymavlink_reads_them(tmp_path, entries):
    if entries == "signed":
        sender = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
        sender.signing.secret_key = bytes(32)
        sender.signing.sign_outgoing = True
        signed = START.to_bytes(8, "big") + bytes(attitude(7).pack(sender))
        entries = [signed, *tlog(10)[1::2][1:]]
    (tmp_path / "log").write_bytes(b"".join(entries))
    ours, report = assert_as_pymavlink(tmp_path / "log", 5)
    assert report.read == {"mavlink/1/1/ATTITUDE": len(ours)} == {"mavlink/1/1/ATTITUDE": 5}
    assert (report.undecodable, report.losses) == ({}, ())


def test_unwanted_frames_are_counted_only(tmp_path):
    text = tlog_entry(START, dialect.MAVLink_statustext_message(6, b"hello"))
    data = b"".join(tlog(5)) + text
    (message,), report = read_log(tmp_path, data, wanted=frozenset({"STATUSTEXT"}))
    assert (message.schema, message.position) == ("STATUSTEXT", 5)
    assert report.read == {"mavlink/1/1/ATTITUDE": 5, "mavlink/1/1/STATUSTEXT": 1}
    assert report.undecodable == {}


def test_a_stamp_that_holds_frame_markers(tmp_path):
    stamps = [0x0006_FDFE_FDFE_FDFE, 0x0006_FDFE_FE06_FD00]
    entries = (tlog_entry(stamp, attitude(k)) for k, stamp in enumerate(stamps))
    messages, report = read_log(tmp_path, b"".join(entries))
    assert [m.time_ns for m in messages] == [stamp * 1000 for stamp in stamps]
    assert report.losses == ()


@pytest.mark.parametrize("at", [0, 3])
def test_a_damaged_stamp_does_not_make_all_that_follows_late(tmp_path, at):
    entries = tlog(6)
    entries[at] = bytes((0, entries[at][1] ^ 0x10)) + entries[at][2:]
    messages, report = read_log(tmp_path, b"".join(entries))
    expected = [10**6 * (k + (k == at)) for k in range(6)]
    assert [m.time_ns // 1000 - START for m in messages] == expected
    assert report.notes == ("1 outlier stamps were replaced by the following stamp",)


@needs(SMALL)
def test_a_real_log_as_pymavlink_reads_it():
    ours, report = assert_as_pymavlink(SMALL, 4000)
    assert len(ours) == sum(report.read.values()) == 35_912
    assert (len(report.losses), report.undecodable) == (4, {})


def test_the_sample_of_telemetry_is_that_of_mcap(tmp_path):
    write_tlog(tmp_path / "made.tlog", open_log(SAMPLES / "glider.mcap").messages())
    assert (tmp_path / "made.tlog").read_bytes() == (SAMPLES / "glider.tlog").read_bytes()
