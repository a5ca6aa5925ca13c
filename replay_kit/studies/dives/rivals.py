"""What a dive would be predicted to be without an estimator: persistence of what was last seen, means, nothing."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.observation import Observation
from replay_kit.estimator.update.screening import usable
from replay_kit.studies.dives.read import Dive

# of a dive's profile: the profile of the last dive (mean of its legs at each depth), of its last leg, ...
PROFILE_RIVALS = ("last_dive", "last_leg", "last_dac", "mean_so_far", "zero")
# of its depth-averaged current
DAC_RIVALS = ("last_dac", "mean_so_far", "zero")


@dataclass(frozen=True, slots=True, eq=False)
class Column:
    """A current by depth.

    Attributes:
        depth: shape (k,) [m], increasing.
        velocity: shape (k, 2) [m/s], true east and north.
    """

    depth: Array
    velocity: Array

    def at(self, depth: Array) -> Array:
        """Return the current at depths, shape (n, 2): linear between those known, the nearest beyond."""
        return np.column_stack([np.interp(depth, self.depth, component) for component in self.velocity.T])


def column(profiles: Sequence[Observation]) -> Column | None:
    """Return the mean of profiles at each depth, in cells as thick as the profiles' bins are apart; None without a usable bin."""
    bins = [usable(profile.flags) for profile in profiles]
    if not any(used.any() for used in bins):
        return None
    depth = np.concatenate([profile.depth[used] for profile, used in zip(profiles, bins, strict=True)])
    velocity = np.concatenate([profile.velocity[used] for profile, used in zip(profiles, bins, strict=True)])
    apart = np.concatenate([np.diff(np.sort(profile.depth)) for profile in profiles])
    width = float(np.median(apart[apart > 0.0])) if np.any(apart > 0.0) else 1.0
    cell = np.round((depth - depth.min()) / width).astype(np.int64)
    _, of_bin, count = np.unique(cell, return_inverse=True, return_counts=True)
    sums = [np.bincount(of_bin, weights=values) / count for values in (depth, *velocity.T)]
    return Column(sums[0], np.column_stack(sums[1:]))


def rival_profiles(before: Sequence[Dive], depth: Array) -> dict[str, Array | None]:
    """Return what each rival says of a profile, shape (n, 2) [m/s], true east and north; None where it has nothing to go by.

    Args:
        before: The dives before, at least one.
        depth: shape (n,) [m].
    """
    last = before[-1]
    columns = {
        "last_dive": column(last.profiles),
        "last_leg": column(last.legs[1] or last.legs[0]),
        "mean_so_far": column([profile for dive in before for profile in dive.profiles]),
    }
    said: dict[str, Array | None] = {name: None if known is None else known.at(depth) for name, known in columns.items()}
    said["last_dac"] = None if last.mean is None else np.tile(np.array(last.mean.velocity), (depth.size, 1))
    said["zero"] = np.zeros((depth.size, 2))
    return {name: said[name] for name in PROFILE_RIVALS}


def rival_means(before: Sequence[Dive]) -> dict[str, Array | None]:
    """Return what each rival says of a depth-averaged current, shape (1, 2) [m/s]; None where it has nothing to go by."""
    known = [np.array([dive.mean.velocity]) for dive in before if dive.mean is not None]
    last = before[-1].mean
    return {
        "last_dac": None if last is None else np.array([last.velocity]),
        "mean_so_far": np.mean(known, axis=0) if known else None,
        "zero": np.zeros((1, 2)),
    }
