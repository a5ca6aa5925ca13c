"""Arrays that may lie on disk."""

import numpy as np
import pytest

from replay_kit.core import arrays
from replay_kit.core.arrays import large_array, one_by_one


@pytest.mark.parametrize("in_memory", [0, 1 << 30], ids=["on disk", "in memory"])
def test_parts_taken_one_by_one_are_those_of_the_array_and_what_is_written_to_them_stays(
    monkeypatch, in_memory
):
    monkeypatch.setattr(arrays, "IN_MEMORY", in_memory)
    array = large_array((3, 600, 2))
    array[:] = np.arange(array.size).reshape(array.shape)
    for number, part in enumerate(one_by_one(array)):
        assert np.array_equal(part, 1200 * number + np.arange(1200).reshape(600, 2))
        part[0] = -1.0
    assert np.all(array[:, 0] == -1.0)
    assert np.array_equal(array[:, 1:].ravel() % 1200, np.tile(np.arange(2, 1200), 3))
