"""The file of a state: values come back as they were, and of what is hostile, cut or damaged nothing is made."""

import os
import pickle

import numpy as np
import pytest

from replay_kit.core.errors import LogError
from replay_kit.core.files.atomic import sealed
from replay_kit.core.observation import Reason
from replay_kit.core.plan import Place
from replay_kit.logs.mcap.writer import McapLogWriter
from replay_kit.measurements.observed import Stream
from replay_kit.workflows.replay.checkpoint import StateError, read_state, write_state


class Called:
    """Pickled as the call of a function."""

    def __init__(self, function, *arguments):
        self.call = function, arguments

    def __reduce__(self):
        return self.call


def back(tmp_path, value):
    write_state(tmp_path / "state", "a run", value)
    return read_state(tmp_path / "state", "a run")


def test_what_is_written_is_read_to_the_bit(tmp_path):
    arrays = (
        np.asfortranarray(np.arange(12.0).reshape(3, 4)),
        np.array([-0.0, np.nan, np.inf]),
        np.arange(6, dtype=np.int8).reshape(2, 3)[:, ::2],
        np.array(["a", "", None, (1.5, 2)], object),
    )
    for wrote, read in zip(arrays, back(tmp_path, arrays), strict=True):
        form = (read.dtype, read.shape, read.flags.fnc)
        assert form == (wrote.dtype, wrote.shape, wrote.flags.fnc)
        assert read.tobytes() == wrote.tobytes() or read.tolist() == wrote.tolist()
    values = (None, True, -3, 1e300, "text", b"\x00\xff", {("a", 1): Place(1.0, -2.0, 3.0)})
    values += Stream(), Reason.DUPLICATE, np.float64(0.1)
    assert repr(back(tmp_path, values)) == repr(values)


@pytest.mark.parametrize(
    "value",
    [
        os.getcwd,
        Called(os.mkdir, "made"),
        Called(write_state, "made", "a run", None),
        Called(McapLogWriter, "made"),
        Called(Place, 1.0),
        Called(Reason, "none"),
        Called(np.ndarray, (1 << 60,)),
    ],
)
def test_what_is_no_value_of_the_program_is_refused_and_nothing_called(
    tmp_path, monkeypatch, value
):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(StateError, match="state: the run cannot resume from it"):
        back(tmp_path, (value,))
    assert [path.name for path in tmp_path.iterdir()] == ["state"]


def test_of_another_form_or_run_it_is_refused(tmp_path):
    value, path = ("text", Place(1.0, 2.0, 3.0)), tmp_path / "state"
    back(tmp_path, value)
    data = path.read_bytes()
    for other in (sealed(b"replay-kit state 1\n"), sealed(pickle.dumps(value)), data[:-84]):
        path.write_bytes(other)
        with pytest.raises(LogError, match="state"):
            read_state(path, "a run")
    path.write_bytes(data)
    with pytest.raises(StateError, match="of another run"):
        read_state(path, "another run")
