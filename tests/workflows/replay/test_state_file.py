"""The file of a state: values come back as they were, and of what is hostile, cut or damaged nothing is made."""

import io
import os
import zipfile
from typing import NamedTuple

import numpy as np
import pytest

from replay_kit.core.errors import LogError
from replay_kit.core.plan import Place
from replay_kit.measurements.observed import Stream
from replay_kit.workflows.replay import state_file
from replay_kit.workflows.replay.state_file import StateError, read_state, write_state

RNG = np.random.default_rng(3)
LOWER = np.asfortranarray(np.tril(RNG.normal(size=(90, 90))))


class Foreign(NamedTuple):
    value: int = 0


def back(tmp_path, value):
    write_state(tmp_path / "state", "a run", value)
    return read_state(tmp_path / "state", "a run")


def test_what_is_written_is_read_to_the_bit_and_what_occurs_twice_is_one(tmp_path):
    arrays = (
        LOWER,
        RNG.normal(size=(3, 4))[:, ::2],
        np.array([-0.0, np.nan, np.inf, 0.0]),
        np.zeros((0, 3)),
        np.arange(6, dtype=np.int8).reshape(2, 3),
        np.array(["a", "", None, (1.5, 2)], object),
        np.array(["deep", "a"]),
    )
    for wrote, read in zip(arrays, back(tmp_path, arrays), strict=True):
        assert (read.dtype, read.shape, read.flags.fnc) == (
            wrote.dtype,
            wrote.shape,
            wrote.flags.fnc,
        )
        assert read.tobytes() == wrote.tobytes() or read.tolist() == wrote.tolist()
    values = (
        None,
        True,
        -3,
        1e300,
        "text",
        b"\x00\xff",
        {("a", 1): Place(1.0, -2.0, 3.0)},
        Stream(),
    )
    assert repr(back(tmp_path, values)) == repr(values)
    once = (tmp_path / "state").stat().st_size
    back(tmp_path, (LOWER, LOWER.copy(order="F")))
    # half of it, and a bit for each zero
    assert (tmp_path / "state").stat().st_size < 0.55 * LOWER.nbytes + once


@pytest.mark.parametrize("value", [os.getcwd, Foreign(), {1, 2}, object()])
def test_what_is_no_value_of_the_program_is_not_written(tmp_path, value):
    with pytest.raises(TypeError, match="not a value of this program"):
        write_state(tmp_path / "state", "a run", (value,))


@pytest.mark.parametrize(
    "tree",
    [
        {"os:getcwd": []},
        {"replay_kit.__main__:main": []},
        {"replay_kit.workflows.replay.state_file:os": []},
        {"replay_kit.results.mcap.file:ResultFile": ["/tmp/it", True, False]},
        {"replay_kit.core.plan:replace": []},
        {"replay_kit.core.plan:Place": [1.0]},
        {"replay_kit.core.observation.block:Reason": "none"},
        {"array": ["<f8", 0, [1 << 40], "C"]},
        {"array": ["<f8", -4, [4], "C"]},
        {"array": ["O", 0, [1], "C"]},
        {"one": 1, "two": 2},
    ],
)
def test_a_hostile_tree_is_refused(tmp_path, monkeypatch, tree):
    monkeypatch.setattr(state_file._Packed, "tree", lambda *_: tree)
    with pytest.raises(StateError, match="state: the run cannot resume from it"):
        back(tmp_path, None)


def test_members_that_state_more_than_the_file_has_take_no_memory(tmp_path):
    for shape, packing in (((1 << 40,), zipfile.ZIP_STORED), ((1 << 27,), zipfile.ZIP_DEFLATED)):
        head = io.BytesIO()
        form = {"descr": "<f8", "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(head, form)
        data = head.getvalue() + bytes(8 if packing == zipfile.ZIP_STORED else 1 << 27)
        with zipfile.ZipFile(tmp_path / "state", "w", packing) as archive:
            archive.writestr("replay-kit state 15.npy", data)
        with pytest.raises(StateError):
            read_state(tmp_path / "state", "a run")


def test_cut_or_with_a_bit_flipped_it_is_refused_or_the_same(tmp_path):
    value, path = (LOWER[:9, :9].copy(), "text", Place(1.0, 2.0, 3.0)), tmp_path / "state"
    assert repr(back(tmp_path, value)) == repr(value)
    data = path.read_bytes()
    for place in range(0, len(data), 7):
        for damaged in (data[:place], data[:place] + bytes([data[place] ^ 4]) + data[place + 1 :]):
            path.write_bytes(damaged)
            try:
                assert repr(read_state(path, "a run")) == repr(value)
            except LogError as error:
                assert str(path) in str(error)  # noqa: PT017
