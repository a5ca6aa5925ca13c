"""Tasks on dives as records: what is known, what is asked, and what an answer states; one JSON line each for programs."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.estimator.next_dive import Mixture, Persistence
from replay_kit.studies.bench.missions import Dive, Mission

#: Tasks on dives' mean currents, and on currents by depth.
MEAN_TASKS = ("next-dive", "planned-dive", "deny-dive", "deny-day")
PROFILE_TASKS = ("profile", "deny-adcp")
DIVE_TASKS = (*MEAN_TASKS, *PROFILE_TASKS)
SHARES = (0.5, 0.9)
_DAY_NS = 86_400 * 10**9


class Stated(Protocol):
    """A distribution of a mean current that an answer states."""

    def log_density(self, velocity: Array) -> float:
        """Return the logarithm of the density at a velocity, shape (2,) [m/s]."""

    def holds(self, velocity: Array) -> tuple[bool, bool]:
        """Return whether the regions of 50 and of 90 % hold a velocity, shape (2,) [m/s]."""


@dataclass(frozen=True, slots=True, eq=False)
class StatedMixture:
    """Gaussians in the plane; their regions are the ellipses of the common mean and covariance."""

    mixture: Mixture

    def log_density(self, velocity: Array) -> float:
        """Return the logarithm of the density at a velocity."""
        return self.mixture.log_density(velocity)

    def holds(self, velocity: Array) -> tuple[bool, bool]:
        """Return whether the ellipses hold a velocity."""
        root = np.linalg.cholesky(self.mixture.cov)
        off = float(np.hypot(*np.linalg.solve(root, velocity - self.mixture.mean)))
        inner, outer = (off <= radius for radius in self.mixture.radii(SHARES))
        return bool(inner), bool(outer)


@dataclass(frozen=True, slots=True, eq=False)
class StatedPersistence:
    """The last dive's mean current with the changes so far, in circles."""

    persistence: Persistence

    def log_density(self, velocity: Array) -> float:
        """Return the logarithm of the density at a velocity."""
        return self.persistence.log_density(velocity)

    def holds(self, velocity: Array) -> tuple[bool, bool]:
        """Return whether the circles hold a velocity."""
        assert self.persistence.velocity is not None
        off = float(np.hypot(*(velocity - self.persistence.velocity)))
        inner, outer = (off <= self.persistence.radius(share) for share in SHARES)
        return inner, outer


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """What a method says of a record.

    Attributes:
        velocity: shape (n, 2) [m/s], true east and north; one row for a mean current.
        std: shape (n, 2) [m/s], of each component; None where it is not stated.
        stated: Distribution of a mean current; None for the Gaussian of ``std``, if that is known.
    """

    velocity: Array
    std: Array | None = None
    stated: Stated | None = None

    @classmethod
    def of_mixture(cls, mixture: Mixture) -> "Answer":
        """Return the answer that states Gaussians of a mean current."""
        std = np.sqrt(np.diag(mixture.cov))
        return cls(mixture.mean[None], std[None], StatedMixture(mixture))


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """What a method is asked.

    Attributes:
        task: Of ``DIVE_TASKS``.
        mission: Its name.
        target: The dive to predict, without what is asked of it.
        truth: shape (n, 2) [m/s], what was measured; no method reads it.
        given: Dives that have become known since the record before.
        known: All known dives, in order.
        backgrounds: shape (2, n, 2) [m/s], by the forecast alone and by the estimate; NaN where they say nothing, None without them.
    """

    task: str
    mission: str
    target: Dive
    truth: Array
    given: tuple[Dive, ...]
    known: tuple[Dive, ...]
    backgrounds: Array | None = None

    def json(self, from_the_first: bool = False) -> dict[str, Any]:
        """Return it as sent to a program; with all known dives as new to one that has just been started."""
        dives = self.known if from_the_first else self.given
        return {
            "task": self.task,
            "mission": self.mission,
            "given": [_dive_json(dive) for dive in dives],
            "target": _dive_json(self.target),
        }


def _dive_json(dive: Dive) -> dict[str, Any]:
    return {
        "dive": dive.number,
        "begin_ns": dive.begin_ns,
        "end_ns": dive.end_ns,
        "place": [each if math.isfinite(each) else None for each in dive.place],
        "way": None if dive.way is None else dive.way.tolist(),
        "mean": None if dive.mean is None else dive.mean.tolist(),
        "depth": dive.depth.tolist(),
        "velocity": dive.velocity.tolist(),
    }


def answer_of_json(said: Any, rows: int) -> Answer:
    """Return a program's answer: ``velocity``, and where it states errors ``std`` or, of a mean current, ``cov``.

    Args:
        said: The decoded line.
        rows: Number of velocities asked.

    Raises:
        ValueError: It is no such object, or a number is not finite, or an error not above 0.
    """
    if not isinstance(said, Mapping) or "velocity" not in said:
        raise ValueError("expected an object with velocity")
    velocity = _numbers(said["velocity"], (rows, 2), "velocity")
    if said.get("cov") is not None:
        cov = _numbers(said["cov"], (2, 2), "cov")
        if rows != 1 or np.any(np.linalg.eigvalsh(cov) <= 0.0):
            raise ValueError("cov: expected a positive definite matrix of one mean current")
        return Answer.of_mixture(Mixture(np.zeros(1), velocity, cov[None]))
    if said.get("std") is None:
        return Answer(velocity)
    std = _numbers(said["std"], (rows, 2), "std")
    if np.any(std <= 0.0):
        raise ValueError("std: expected numbers above 0")
    if rows == 1:
        return Answer.of_mixture(Mixture(np.zeros(1), velocity, np.diag(std[0] ** 2)[None]))
    return Answer(velocity, std)


def _numbers(value: Any, shape: tuple[int, int], name: str) -> Array:
    try:
        found = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{name}: expected numbers") from None
    if found.shape != shape or not np.isfinite(found).all():
        raise ValueError(f"{name}: expected finite numbers of shape {shape}, got {found.shape}")
    return found


def records(task: str, mission: Mission) -> Iterator[Record]:
    """Yield what is asked of a mission, dive after dive that has what is asked; the first ones without a known dive.

    ``next-dive`` is predicted from all dives before it, ``deny-dive`` without the last of these, ``deny-day`` without those of the day
    before; ``planned-dive`` does not know the way through the water. ``profile`` is the current by depth of the next dive; in
    ``deny-adcp`` the instrument is withheld: only mean currents are known, that of the dive itself among them.
    """
    dives = mission.dives
    if task == "deny-adcp":
        dives = tuple(replace(dive, given=_paths(dive)) for dive in dives)
    sent = 0
    for k, dive in enumerate(dives):
        known = dives[: max(k - 1, 0)] if task == "deny-dive" else dives[:k]
        if task == "deny-day":
            known = tuple(each for each in known if each.end_ns <= dive.begin_ns - _DAY_NS)
        if task == "deny-adcp":
            known = tuple(_without_bins(each) for each in known)
        truth = _truth(task, dive)
        if truth is None:
            continue
        target = replace(dive, velocity=np.empty((0, 2)), given=(), inverted=None)
        if task in MEAN_TASKS:
            target = replace(target, mean=None, depth=np.empty(0))
        elif task == "profile":
            target = replace(target, mean=None)
        if task == "planned-dive":
            target = replace(target, way=None)
        yield Record(task, mission.name, target, truth, known[sent:], known)
        sent = len(known)


def _paths(dive: Dive) -> tuple[Any, ...]:
    return () if dive.path is None else (dive.path,)


def _without_bins(dive: Dive) -> Dive:
    return replace(dive, depth=np.empty(0), velocity=np.empty((0, 2)))


def _truth(task: str, dive: Dive) -> Array | None:
    if task in PROFILE_TASKS:
        return dive.velocity if dive.depth.size else None
    if task == "planned-dive" and dive.way is None:
        return None
    return None if dive.mean is None else dive.mean[None]
