"""Predictions of a dive without an estimator: persistence of the last dive, means of all dives, and no current."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.observation import Observation, usable
from replay_kit.studies.dives.read import Dive

#: Baselines of a dive's profile, in the order of the tables.
PROFILE_BASELINES = ("last_dive", "last_leg", "last_dac", "mean_so_far", "zero")


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
        return np.column_stack(
            [np.interp(depth, self.depth, component) for component in self.velocity.T]
        )


def column(profiles: Sequence[Observation]) -> Column | None:
    """Return the mean of profiles at each depth, in cells as thick as the profiles' bins are apart; None without a usable bin."""
    bins = [usable(profile.flags) for profile in profiles]
    if not any(used.any() for used in bins):
        return None
    depth = np.concatenate(
        [profile.depth[used] for profile, used in zip(profiles, bins, strict=True)]
    )
    velocity = np.concatenate(
        [profile.velocity[used] for profile, used in zip(profiles, bins, strict=True)]
    )
    apart = np.concatenate([np.diff(np.sort(profile.depth)) for profile in profiles])
    width = float(np.median(apart[apart > 0.0])) if np.any(apart > 0.0) else 1.0
    cell = np.round((depth - depth.min()) / width).astype(np.int64)
    _, of_bin, count = np.unique(cell, return_inverse=True, return_counts=True)
    sums = [np.bincount(of_bin, weights=values) / count for values in (depth, *velocity.T)]
    return Column(sums[0], np.column_stack(sums[1:]))


def baseline_profiles(before: Sequence[Dive], depth: Array) -> dict[str, Array]:
    """Return what each baseline predicts of a profile, shape (n, 2) [m/s], true east and north; without those that lack data.

    ``last_dive`` is the mean at each depth of the last dive's profiles, ``last_leg`` that of its last leg, ``last_dac`` its
    depth-averaged current, ``mean_so_far`` the mean at each depth of all profiles.

    Args:
        before: The dives before, at least one.
        depth: shape (n,) [m].
    """
    last, zero = before[-1], np.zeros((depth.size, 2))
    profiles = {
        "last_dive": last.profiles,
        "last_leg": last.legs[1] or last.legs[0],
        "mean_so_far": [profile for dive in before for profile in dive.profiles],
    }
    columns = {name: column(given) for name, given in profiles.items()}
    predicted = {name: known.at(depth) for name, known in columns.items() if known is not None}
    means = {
        name: zero + mean for name, mean in baseline_means(before).items() if name != "mean_so_far"
    }
    return {
        name: (means | predicted)[name] for name in PROFILE_BASELINES if name in means | predicted
    }


def baseline_means(before: Sequence[Dive]) -> dict[str, Array]:
    """Return what each baseline predicts of a depth-averaged current, shape (1, 2) [m/s]; without those that lack data."""
    known = [np.array([dive.mean.velocity]) for dive in before if dive.mean is not None]
    predicted = {} if before[-1].mean is None else {"last_dac": known[-1]}
    if known:
        predicted["mean_so_far"] = np.mean(known, axis=0)
    return predicted | {"zero": np.zeros((1, 2))}
