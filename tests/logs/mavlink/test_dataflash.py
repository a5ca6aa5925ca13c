"""DataFlash logs: as pymavlink's reader gives them, with UTC where GPS has it, and damage counted and stepped over."""

import numpy as np
import pytest
from pymavlink import DFReader

from replay_kit.logs import open_log
from replay_kit.logs.mavlink.dataflash import Format
from tests.logs.log_samples import SHARED, read_log
from tests.logs.mavlink.dataflash_samples import (
    dataflash,
    declaration,
    declarations,
    form,
    gps,
    record,
)
from tests.places import needs

SMALL = SHARED / "ardusub" / "small.BIN"
real = needs(SMALL)


def slow_twin(path):
    log = DFReader.DFReader_binary(str(path), zero_time_base=False)
    found = []
    while (message := log.recv_msg()) is not None:
        found.append(message)
    log.close()
    return found


def assert_as_pymavlink(path):
    ours, theirs = list(open_log(path).messages()), slow_twin(path)
    assert len(ours) == len(theirs)
    for mine, other in zip(ours, theirs, strict=True):
        expected = {
            name: list(value) if hasattr(value, "tolist") else value
            for name, value in other.to_dict().items()
        }
        assert mine.schema == f"dataflash.{expected.pop('mavpackettype')}"
        assert repr(mine.payload) == repr(expected)


def test_as_pymavlink_reads_it(tmp_path):
    mix = record(
        form("MIX"),
        b"abcd",
        b"e" * 16,
        -1,
        255,
        -2,
        65535,
        -3,
        2**32 - 1,
        -(2**63),
        10**9,
        1.5,
        0.1,
        -7,
        8,
        -9,
        10,
    )
    piece = record(form("FILE"), b"param.txt", 128, 3, b"a\x00\xff")
    mode = record(form("MODE"), 300_000_000, 19, 19, 1)
    (tmp_path / "log").write_bytes(b"".join(dataflash(5)) + mix + piece + mode)
    assert {"dataflash.MIX", "dataflash.FILE", "dataflash.MODE"} < {
        m.schema for m in open_log(tmp_path / "log").messages()
    }
    assert_as_pymavlink(tmp_path / "log")


@real
def test_a_real_log_as_pymavlink_reads_it():
    assert_as_pymavlink(SMALL)
    reader = open_log(SMALL)
    assert sum(1 for _ in reader.messages()) == sum(reader.report().read.values()) == 7510
    assert reader.report().losses == ()
    assert reader.report().notes[0].startswith("no GPS time")
    assert reader.report().notes[1] == "239 stamps go backwards, by up to 0.333 ms"


def test_times_are_utc_by_gps(tmp_path):
    late = gps(266_500_000, 200_000_000)
    no_fix = gps(267_500_000, 0, week=0, status=1)
    parts = dataflash(20)
    messages, report = read_log(
        tmp_path, b"".join([*parts[:20], late, *parts[20:40], no_fix, *parts[40:]])
    )
    utc = int(np.datetime64("2024-02-07T11:19:42", "ns").astype(np.int64))
    assert {m.time_ns - 1000 * m.payload["TimeUS"] for m in messages if "TimeUS" in m.payload} == {
        utc - 265_000_000_000
    }
    # FMT has no stamp and goes with what follows it
    assert messages[0].time_ns == next(m.time_ns for m in messages if "TimeUS" in m.payload)
    assert "less 18 leap seconds" in report.notes[0]
    assert "21 pairs, 1 outliers, residual 0.0 ms" in report.notes[0]


def test_a_kind_declared_anew(tmp_path):
    old, new = form("CTUN"), form("MSG")
    other = type(old)(old.type, "CTUN", new.length, new.letters, new.columns)
    data = (
        declarations()
        + record(old, 1000, -1.0, -2.0, 3)
        + declaration(other)
        + record(other, 2000, b"now text")
    )
    messages, _ = read_log(tmp_path, data)
    assert [m.payload for m in messages if m.schema == "dataflash.CTUN"] == [
        {"TimeUS": 1000, "Alt": -1.0, "BAlt": -2.0, "CRt": 0.03},
        {"TimeUS": 2000, "Message": "now text"},
    ]


@pytest.mark.parametrize(
    ("letters", "columns"),
    [("Qw", "TimeUS,X"), ("Qf", "TimeUS"), ("Qh", "TimeUS,X"), ("QI", "X,X")],
)
def test_a_kind_whose_declaration_is_not_understood_is_stepped_over(tmp_path, letters, columns):
    odd = Format(200, "ODD", 3 + 12, letters, tuple(columns.split(",")))
    parts = dataflash(3)
    unknown = b"\xa3\x95\xc8" + bytes(12)
    messages, report = read_log(
        tmp_path, b"".join([parts[0], declaration(odd), *parts[1:4], unknown, *parts[4:], unknown])
    )
    assert len(messages) == len(read_log(tmp_path, b"".join(parts))[0]) + 1
    assert report.losses == ()
    assert report.read["dataflash/ODD"] == report.undecodable["dataflash/ODD"][0] == 2


def test_an_impossible_stamp_takes_the_time_before(tmp_path):
    wild = record(form("CTUN"), 2**63, -1.0, -1.0, 0)
    messages, report = read_log(tmp_path, b"".join([*dataflash(2), wild]))
    assert messages[-1].time_ns == messages[-2].time_ns
    assert report.notes[1:] == (
        "2 stamps go backwards, by up to 0.010 ms",
        "1 records with an impossible stamp were given the time of the record before",
    )
