"""DataFlash logs: as pymavlink's reader gives them, with UTC where GPS has it, and damage counted and stepped over."""

from dataclasses import replace

import numpy as np
import pytest
from pymavlink import DFReader

from replay_kit.logs import open_log
from tests.logs.log_samples import SHARED, read_log
from tests.logs.mavlink.dataflash_samples import (
    Format,
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


def assert_as_pymavlink(path, count):
    reader, theirs = open_log(path), DFReader.DFReader_binary(str(path), zero_time_base=False)
    messages = list(reader.messages())
    assert len(messages) == sum(reader.report().read.values()) == count
    for mine in messages:
        expected = {
            name: list(value) if hasattr(value, "tolist") else value
            for name, value in theirs.recv_msg().to_dict().items()
        }
        assert mine.schema == f"dataflash.{expected.pop('mavpackettype')}"
        assert repr(mine.payload) == repr(expected)
    assert theirs.recv_msg() is None
    theirs.close()
    return reader.report()


def test_as_pymavlink_reads_it(tmp_path):
    whole = [-1, 255, -2, 65535, -3, 2**32 - 1, -(2**63), 10**9]
    parts = [
        *dataflash(5),
        record(form("MIX"), b"abcd", b"e" * 16, *whole, 1.5, 0.1, -7, 8, -9, 10),
        record(form("FILE"), b"param.txt", 128, 3, b"a\x00\xff"),
        record(form("MODE"), 300_000_000, 19, 19, 1),
    ]
    (tmp_path / "log").write_bytes(b"".join(parts))
    assert_as_pymavlink(tmp_path / "log", b"".join(parts).count(b"\xa3\x95"))


@real
def test_a_real_log_as_pymavlink_reads_it():
    report = assert_as_pymavlink(SMALL, 7510)
    assert report.losses == ()
    assert report.notes[0].startswith("no GPS time")
    assert report.notes[1] == "239 stamps go backwards, by up to 0.333 ms"


def test_times_are_utc_by_gps(tmp_path):
    late, no_fix = gps(266_500_000, 200_000_000), gps(267_500_000, 0, week=0, status=1)
    wild, parts = record(form("CTUN"), 2**63, -1.0, -1.0, 0), dataflash(20)
    parts = [*parts[:20], late, *parts[20:40], no_fix, *parts[40:], wild]
    messages, report = read_log(tmp_path, b"".join(parts))
    utc = np.datetime64("2024-02-07T11:19:42", "ns").astype(np.int64)
    *stamped, last = [m for m in messages if "TimeUS" in m.payload]
    offsets = {m.time_ns - 1000 * m.payload["TimeUS"] for m in stamped}
    assert offsets == {utc - 265_000_000_000}
    # FMT has no stamp and goes with what follows it
    assert messages[0].time_ns == stamped[0].time_ns
    assert last.time_ns == stamped[-1].time_ns
    fit, backwards, impossible = report.notes
    assert "less 18 leap seconds" in fit
    assert "21 pairs, 1 outliers, residual 0.0 ms" in fit
    assert "stamps go backwards, by up to" in backwards
    assert impossible.startswith("1 records with an impossible stamp")


def test_a_kind_declared_anew(tmp_path):
    old, new = form("CTUN"), form("MSG")
    other = replace(new, type=old.type, name="CTUN")
    parts = declarations(), record(old, 1000, -1.0, -2.0, 3), declaration(other)
    messages, _ = read_log(tmp_path, b"".join([*parts, record(other, 2000, b"now text")]))
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
    first, *rest = dataflash(3)
    alone, unknown = len(read_log(tmp_path, first + b"".join(rest))[0]), b"\xa3\x95\xc8" + bytes(12)
    parts = [first, declaration(odd), *rest[:3], unknown, *rest[3:], unknown]
    messages, report = read_log(tmp_path, b"".join(parts))
    assert (len(messages), report.losses) == (alone + 1, ())
    assert report.read["dataflash/ODD"] == report.undecodable["dataflash/ODD"][0] == 2
