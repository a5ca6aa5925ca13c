"""``replace`` against the standard library's."""

import dataclasses
from dataclasses import dataclass

import pytest

from replay_kit.core.frozen import replace
from replay_kit.measurements import MeasurementState


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
    with pytest.raises(KeyError):
        replace(MeasurementState(), dives_made=1)


def test_values_that_are_checked_when_they_are_made_are_checked_when_changed():
    assert replace(Checked(1.0, 2.0), high=3.0) == Checked(1.0, 3.0)
    with pytest.raises(ValueError, match="low"):
        replace(Checked(1.0, 2.0), high=0.0)
