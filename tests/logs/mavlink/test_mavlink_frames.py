"""Frames found and checked many at a time, as they are one by one."""

from io import BytesIO

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20.ardupilotmega import x25crc

from replay_kit.logs.blocks import ReadStatistics, chain
from replay_kit.logs.mavlink import frames as mavlink_frames
from replay_kit.logs.mavlink.frames import PADDING, checksums
from tests.logs.log_samples import tlog
from tests.reference.mavlink import slow_chain

quick = settings(max_examples=60, deadline=None, derandomize=True)


@quick
@given(
    data=st.binary(min_size=300, max_size=700),
    ends=st.lists(st.tuples(st.integers(0, 300), st.integers(0, 268)), max_size=30),
)
def test_checksums_of_stretches_of_all_lengths(data, ends):
    start, length = np.array(ends, dtype=np.int64).reshape(-1, 2).T
    end = np.minimum(start + length, len(data))
    extra = (7 * np.arange(len(ends)) % 256).astype(np.uint16)
    crc = checksums(np.frombuffer(data + bytes(PADDING), dtype=np.uint8), start, end, extra)
    stretches = zip(start, end, extra.tolist(), strict=True)
    assert crc.tolist() == [x25crc(data[a:b] + bytes((e,))).crc for a, b, e in stretches]


@quick
@given(
    st.lists(
        st.tuples(st.integers(0, 400), st.integers(1, 60)),
        max_size=40,
        unique_by=lambda record: record[0],
    )
)
def test_a_chain_is_what_one_walk_meets(records):
    spans = sorted((start, start + length) for start, length in records)
    start, end = np.array(spans, dtype=np.int64).reshape(-1, 2).T
    assert chain(start, end).tolist() == slow_chain(spans)


def places(data):
    statistics = ReadStatistics()
    blocks = list(mavlink_frames.read_frames(BytesIO(data), statistics))
    found = [place + frames.offset for frames in blocks for place in frames.start.tolist()]
    return found, statistics.report("", ""), max(len(frames.data) for frames in blocks)


@pytest.mark.parametrize("block", [1, 7, 64, 700])
def test_any_size_of_block_finds_the_same(monkeypatch, block):
    entries = tlog(30)
    parts = [b"\xfe\xfd", *entries[:11], bytes(400), *entries[11:], entries[0][:-1]]
    whole, losses, _ = places(b"".join(parts))
    assert len(whole) == 30
    assert [loss.bytes for loss in losses.losses] == [2, 400, len(entries[0]) - 1]
    monkeypatch.setattr(mavlink_frames, "BLOCK", block)
    *found, in_memory = places(b"".join(parts))
    assert found == [whole, losses]
    assert in_memory < 1500 + block
