"""Which bins an estimate can use, at each limit: on it, and to either side."""

from dataclasses import replace

import numpy as np
import pytest

from replay_kit.core.grid import Grid
from replay_kit.core.observation import Flag, Profiles, Reason
from replay_kit.estimator.update.screening import screen, screened
from tests import synthetic
from tests.estimator.seas import dive

GRID = synthetic.ensemble(levels=np.array([5.0, 65.0, 165.0])).grid

SHALLOW = replace(GRID, wet=GRID.wet & (np.arange(3) == 0)[:, None, None])


def of_depths(depth, grid: Grid = GRID, relative: bool = False, **changes):
    depth = np.asarray(depth, dtype=float)
    profile = synthetic.profile(grid, 0.0, 0.0, depth, np.zeros((depth.size, 2)))
    columns = Profiles.of([replace(profile, **changes)]).columns
    (flags,), (reasons,) = screen(columns, grid, relative)
    return flags, reasons


@pytest.mark.parametrize(
    ("depth", "changes", "used", "reason"),
    [
        ([np.nextafter(165.0, 0.0), 165.0, np.nextafter(165.0, 200.0)], {}, 2, Reason.BELOW_GRID),
        ([10.0, 20.0, 30.0], {"error_std": [5e-324, 1.0, 0.0]}, 2, Reason.MALFORMED),
        ([10.0, 20.0, 30.0], {"error_std": [5e-324, 1.0, np.inf]}, 2, Reason.MALFORMED),
        # between two levels the nearer one tells, in the middle the upper one
        ([34.999, 35.0, 35.001], {"grid": SHALLOW}, 2, Reason.ON_LAND),
    ],
)
def test_a_bin_is_used_on_a_limit_and_not_beyond_it(depth, changes, used, reason):
    given = changes | {name: np.array(each) for name, each in changes.items() if name != "grid"}
    flags, reasons = of_depths(depth, **given)
    assert flags.tolist() == [Flag.GOOD] * used + [Flag.FAIL] * (3 - used)
    assert reasons.tolist() == [0] * used + [reason] * (3 - used)


@pytest.mark.parametrize(
    ("flags", "relative", "used"),
    [
        ([Flag.GOOD], True, 0),
        ([Flag.GOOD] * 2, True, 2),
        ([Flag.GOOD, Flag.SUSPECT], True, 2),
        ([Flag.GOOD] * 3, True, 3),
        ([Flag.GOOD] * 3, False, 0),
    ],
)
def test_two_bins_say_something_of_their_difference_and_one_alone_does_not(flags, relative, used):
    given = np.array(flags + [Flag.MISSING] * (4 - len(flags)), np.int8)
    unknown = {"common_std": np.inf, "reference": "platform"}
    found, reasons = of_depths([10.0, 20.0, 30.0, 40.0], relative=relative, flags=given, **unknown)
    assert found[: len(flags)].tolist() == (flags if used else [Flag.FAIL] * len(flags))
    assert np.all((reasons & Reason.PLATFORM_REFERENCE > 0) == (used == 0))


def test_the_edge_of_the_region_belongs_to_it():
    east = float(GRID.east[2, -1])
    inside, outside = (
        synthetic.profile(
            GRID, east + away, float(GRID.north[2, -1]), np.array([10.0]), np.zeros((1, 2))
        )
        for away in (0.0, 2.0)
    )
    flags, reasons = screen(Profiles.of([inside, outside]).columns, GRID)
    assert flags[0] == Flag.GOOD
    assert reasons[1] == Reason.OUTSIDE_REGION


def test_a_mean_along_a_path_stands_where_half_of_its_time_has_passed():
    mean = replace(
        dive(),
        longitude=np.array([152.0, 152.1, 152.2, 152.3]),
        latitude=np.full(4, -40.0),
        depth=np.array([0.0, 100.0, 100.0, 0.0]),
        weight=np.full(4, 0.25),
    )
    # exactly half of it with the second point, a little less, and all of it with the last
    assert mean.linear.middle == (152.1, -40.0)
    assert replace(mean, weight=np.array([0.25, 0.249, 0.251, 0.25])).linear.middle[0] == 152.2
    assert replace(mean, weight=np.array([0.0, 0.0, 0.0, 0.4999])).linear.middle[0] == 152.3
    assert mean.linear.value_depth.tolist() == [50.0]


PROFILE = synthetic.profile(
    GRID, 1e3, 2e3, np.array([20.0, 40.0]), np.array([[0.1, np.nan], [0.2, -0.1]]), 0.05, time_ns=7
)


def is_duplicate(first, other):
    """Whether the second of two measurements is refused as the first one, logged twice."""
    return screened([first, other], GRID)[0][1].refused.tolist() == [Reason.DUPLICATE]


@pytest.mark.parametrize("number", [np.float64, np.float32])
def test_the_same_numbers_are_the_same_observation_missing_ones_too(number):
    same = replace(PROFILE, velocity=PROFILE.velocity.astype(number))
    assert is_duplicate(PROFILE, same)
    assert is_duplicate(dive(), dive())
    # also of another block
    assert screened([same], GRID, screened([PROFILE], GRID)[1])[0][0].refused.tolist() == [
        Reason.DUPLICATE
    ]


@pytest.mark.parametrize("name", ["time_ns", "longitude", "latitude", "depth", "velocity"])
def test_one_other_number_makes_another_observation(name):
    other = replace(PROFILE, **{name: getattr(PROFILE, name) + 1e-3})
    if name == "time_ns":
        other = replace(PROFILE, time_ns=PROFILE.time_ns + 1)
    assert not is_duplicate(PROFILE, other)
