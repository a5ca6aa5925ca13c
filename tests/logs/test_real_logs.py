"""Real logs of every format are measured as the record says."""

import pytest

from tests.places import DATA, needs
from tests.record import measured, record

#: Takes some seconds each.
_SLOW = ("adcp/RDI_withBT.000", "adcp/vmdas01_wh.ENX")
#: Of which more, or better, is said than 0.3 did: positions of poses, and those before the first fix; currents of no dive.
_BETTER = ("logs/ardusub/small.tlog", "slocum/*.?bd", "glider/og1_sp028_20230202T1637_R.nc")


@needs(DATA)
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.full) if name in _SLOW else name
        for name in measured.logs()
        if (DATA / name).parent.exists() and name not in _BETTER
    ],
)
def test_real_logs_are_measured_as_before(name):
    assert record.difference("measured", measured.answers([name])) == []
