"""A few hostile inputs in processes of their own; the others are tested where they are read."""

import resource
from collections.abc import Callable
from unittest.mock import Mock

import numpy as np
import pytest

from replay_kit.config.run import ForecastConfig
from replay_kit.core.errors import ForecastError
from replay_kit.core.files import inputs
from replay_kit.forecast import read_ensemble
from tests.command import invoke
from tests.fuzz.attacks import ATTACKS
from tests.fuzz.bombs import field
from tests.fuzz.hostile import MOST_MB, MOST_S, measured

# of each kind of file one whose cost was not in one decoder
KINDS = (
    "chunk: 250 MB of zeros",
    "NetCDF ensemble: grid of 10^10 cells",
    "NetCDF glider: 2 billion samples",
)


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[] if name in KINDS else pytest.mark.full) for name in ATTACKS],
)
def test_a_hostile_input_ends_soon_and_small(tmp_path, name):
    took = measured(ATTACKS[name](tmp_path), tmp_path)
    assert took.code in ((3, 4) if name in KINDS else (0, 2, 3, 4))
    assert "Traceback" not in took.said
    assert took.megabytes < MOST_MB
    # processor time, which other work on the machine does not lengthen
    assert took.seconds < MOST_S


@pytest.mark.parametrize("name", ["drifters: 60 MB of commas", "radar: axes of a million points"])
def test_a_table_or_grid_that_cannot_be_is_refused_before_it_is_made(tmp_path, name):
    done = invoke(ATTACKS[name](tmp_path))
    assert done.exit_code == 3
    assert "a line of" in done.stderr or "as lat and lon have" in done.stderr


def test_bytes_that_become_more_than_they_may_are_refused_and_no_limit_stays(tmp_path):
    before = resource.getrlimit(resource.RLIMIT_DATA)
    small = {"member": 3, "depth": 2, "lat": 8, "lon": 8}
    waves = np.sin(np.arange(50.0)).astype("f4").tobytes()
    for words, make in (
        ("OSError", field(small, chunk=150_000_000)),
        ("all 3 members are identical", field(small, waves)),
    ):
        with pytest.raises(ForecastError, match=words):
            read_ensemble(make(tmp_path), ForecastConfig())
    assert resource.getrlimit(resource.RLIMIT_DATA) == before


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (MemoryError("no room"), MemoryError),
        (RuntimeError("another"), RuntimeError),
        # as Python says it of a thread that has no room for its stack
        (RuntimeError("can't start new thread"), MemoryError),
    ],
)
def test_the_limit_stays_a_while_for_threads_that_nothing_stops(error, told, monkeypatch):
    before = resource.getrlimit(resource.RLIMIT_DATA)
    begun = list[Callable[[], None]]()
    monkeypatch.setattr(inputs.threading, "Timer", lambda _, ended: begun.append(ended) or Mock())
    with pytest.raises(told), inputs.unpacking(threads=2):
        raise error
    assert resource.getrlimit(resource.RLIMIT_DATA) != before
    begun[0]()
    assert resource.getrlimit(resource.RLIMIT_DATA) == before
