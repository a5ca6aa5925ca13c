"""A few hostile inputs in processes of their own; the others are tested where they are read."""

import pytest

from tests.fuzz.attacks import ATTACKS
from tests.fuzz.hostile import MOST_MB, MOST_S, measured

# of each kind of file one whose cost was not in one decoder
KINDS = (
    "chunk: 250 MB of zeros",
    "NetCDF ensemble: grid of 10^10 cells",
    "NetCDF glider: 2 billion samples",
)


@pytest.mark.parametrize("name", KINDS)
def test_a_hostile_input_ends_soon_and_small(tmp_path, name):
    took = measured(ATTACKS[name](tmp_path), tmp_path)
    assert took.code in (3, 4)
    assert "Traceback" not in took.said
    assert took.megabytes < MOST_MB
    # processor time, which other work on the machine does not lengthen
    assert took.seconds < MOST_S


@pytest.mark.full
@pytest.mark.parametrize("name", [name for name in ATTACKS if name not in KINDS])
def test_every_other_hostile_input_ends_soon_and_small(tmp_path, name):
    took = measured(ATTACKS[name](tmp_path), tmp_path)
    assert took.code in (0, 2, 3, 4)
    assert "Traceback" not in took.said
    assert took.megabytes < MOST_MB
    assert took.seconds < MOST_S
