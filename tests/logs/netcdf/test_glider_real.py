"""The table in ``logs/netcdf/README.md``: what each real file holds, counted in the messages of its reader."""

import re

import pytest

from tests.logs.said import read
from tests.places import DATA, ROOT, needs

FOLDER = DATA / "glider"
# file, dialect, dives, mean currents, fixes
ROWS = re.findall(
    r"\| `(\S+)` \| (\w+) \| (\d+) \| (\d+) \| (\d+) \|",
    (ROOT / "replay_kit/logs/netcdf/README.md").read_text(),
)


def _dives(messages):
    """Times that the depth of the positions goes below 3 m, counted anew below 1.5 m."""
    count, under = 0, False
    for message in messages:
        if message.topic.startswith("/vehicle"):
            depth = float(message.payload["metadata"][0]["value"])
            count += depth > 3.0 and not under
            under = depth > 3.0 or (under and depth > 1.5)
    return count


def test_the_page_lists_files():
    assert len(ROWS) == 10


@needs(FOLDER)
@pytest.mark.parametrize(("name", "dialect", *("dives", "means", "fixes")), ROWS)
def test_each_file_is_read_as_the_page_states(name, dialect, dives, means, fixes):
    said = read(FOLDER / name)
    counted = _dives(said.messages), len(said.of("/dac")), len(said.of("/vehicle/fix"))
    assert (said.report.format, *map(str, counted)) == (dialect, dives, means, fixes)
    assert said.report.losses == ()
