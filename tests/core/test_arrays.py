"""Arrays that may lie on disk, and values changed against the standard library."""

import dataclasses
from dataclasses import dataclass

import numpy as np
import pytest

from replay_kit.core import arrays
from replay_kit.core.arrays import large_array, one_by_one, replace
from replay_kit.measurements import MeasurementState


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


@dataclass(frozen=True, slots=True)
class Checked:
    """A value that is refused."""

    low: float
    high: float

    def __post_init__(self) -> None:
        """Raise ValueError where the limits are exchanged."""
        if self.low > self.high:
            raise ValueError("low > high")


@dataclass(frozen=True)
class Plain:
    """A value without slots."""

    one: int = 1
    other: int = 2


def test_changed_values_are_those_of_the_standard_library_and_what_they_were_made_of_stays():
    before = MeasurementState(depth=3.0, dive=2)
    after = replace(before, submerged=True, dive=3)
    assert after == dataclasses.replace(before, submerged=True, dive=3)
    assert (before.dive, before.submerged) == (2, False)
    assert replace(Plain(), other=5) == Plain(1, 5)


def test_a_changed_value_is_frozen_and_has_no_other_fields():
    after = replace(MeasurementState(), dive=1)
    with pytest.raises(dataclasses.FrozenInstanceError):
        after.dive = 2
    with pytest.raises(AttributeError):
        replace(MeasurementState(), dives_made=1)


def test_values_that_are_checked_when_they_are_made_are_checked_when_changed():
    assert replace(Checked(1.0, 2.0), high=3.0) == Checked(1.0, 3.0)
    with pytest.raises(ValueError, match="low"):
        replace(Checked(1.0, 2.0), high=0.0)
