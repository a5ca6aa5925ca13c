"""Half-planes that keep the places of a mission clear of obstacles, and the safety margins by which they are moved."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import nctdtrit, ndtri

from planners.mission.solve.attempt import LegsProblem
from planners.mission.task import turns_of
from planners.route.hazards import NearRings, Ring, near_rings
from planners.shooting.walls import Walls
from replay_kit.core.arrays import Array

# Half-planes for each point of a path.
_PLANES = 3
# Confidence that a margin from few samples covers the share it is made for.
_CONFIDENCE = 0.99
# A larger share than this cannot be told from all.
_MOST = 0.999


@dataclass(frozen=True, slots=True, eq=False)
class SafetyMargin:
    """Margins from the deviations of K flights from the predicted one.

    Attributes:
        deviations: shape (K, n, 2) [m], at places evenly numbered along the mission, the start not counted.
        share: Share of all flights that must keep clear.
        extra: Margin in addition to the deviation of this share [m].
    """

    deviations: Array
    share: float
    extra: float

    def margins(self, normals: Array) -> Array:
        """Return the additional distance kept at each place, shape (n, P) [m], for normals of half-planes, shape (n, P, 2).

        The places may be more or fewer than those of the flights.
        """
        numbers = np.linspace(0.0, 1.0, self.deviations.shape[1] + 1)[1:]
        at = np.linspace(0.0, 1.0, len(normals) + 1)[1:]
        moved = np.array(
            [[np.interp(at, numbers, flight[:, i]) for i in (0, 1)] for flight in self.deviations]
        )
        towards = np.einsum("kcn,npc->knp", moved, normals)
        deviation_std = np.std(towards, axis=0, ddof=1) if len(towards) > 1 else 0.0
        limits = np.linalg.norm(normals, axis=2) > 0.0
        needed = (
            np.mean(towards, axis=0) + tolerance_factor(len(towards), self.share) * deviation_std
        )
        return np.where(limits, np.maximum(needed, 0.0) + self.extra, 0.0)


def tolerance_factor(count: int, share: float) -> float:
    """Return the one-sided tolerance factor of a normal sample at a confidence of 99 %.

    The mean of the sample plus so many of its standard deviations is above the quantile ``share`` of the population with that
    confidence: mean and standard deviation are themselves estimated from few values.

    Args:
        count: Number of values.
        share: Of the population, to be covered.
    """
    share = min(share, _MOST)
    if count < 2:
        return float(ndtri(share))
    return float(nctdtrit(count - 1, ndtri(share) * np.sqrt(count), _CONFIDENCE) / np.sqrt(count))


# Between the ends of a step half-planes follow it at one of these shares in each of so many parts.
_PARTS = 3
_BETWEEN = (np.arange(18) + 0.5) / 18.0


def with_margin(walls: Walls, margin: SafetyMargin) -> Walls:
    """Return half-planes that stay, moved by a safety margin."""
    assert walls.planes is not None, "half-planes that follow the places have no safety margin"
    planes = walls.planes.reshape(-1, *walls.planes.shape[2:]).copy()
    planes[..., 2] -= margin.margins(planes[..., :2])
    return replace(walls, planes=planes.reshape(walls.planes.shape))


def standing_walls(problem: LegsProblem, path: Array) -> Walls:
    """Return half-planes that touch the rings nearest to the places of a path, shape (L, n_places, 2) [m]."""
    at, surfaced = np.repeat(path[:, :, None], _PLANES, axis=2), _surfaced(problem, path.shape[1])
    near = _near(problem, path, surfaced, _PLANES)
    return Walls(np.ones(at.shape[:3]), near.planes(at.reshape(-1, 2))[0].reshape(*at.shape[:3], 3))


def following_walls(problem: LegsProblem, path: Array) -> Walls:
    """Return what the places of legs keep clear of, and each third of the steps between them where it is nearest to an obstacle."""
    surfaced = _surfaced(problem, path.shape[1])
    begins = np.concatenate(
        [np.vstack([problem.task.start[None, :2], path[:-1, -1]])[:, None], path[:, :-1]], axis=1
    )
    adrift = surfaced & np.concatenate([np.full((len(path), 1), False), surfaced[:, :-1]], axis=1)
    shares = np.tile(_BETWEEN, (*path.shape[:2], 1))
    along = begins[:, :, None] + shares[..., None] * (path - begins)[:, :, None]
    near = _near(problem, along, np.repeat(adrift[..., None], shares.shape[2], axis=2), 1)
    clear = near.clearance(along.reshape(-1, 2)).reshape(*path.shape[:2], _PARTS, -1)
    worst = np.argmin(clear, axis=3)[..., None] + np.arange(_PARTS)[:, None] * clear.shape[3]
    between, which = (
        np.take_along_axis(one.reshape(shares.shape), worst[..., 0], axis=2)
        for one in (shares, near.which)
    )
    ends = _near(problem, path, surfaced, _PLANES)
    both = np.concatenate([ends.which.reshape(*path.shape[:2], -1), which], axis=2)
    return Walls(
        np.concatenate([np.ones((*path.shape[:2], _PLANES)), between], axis=2),
        obstacles=replace(ends, which=both.ravel()),
    )


def _surfaced(problem: LegsProblem, n_places: int) -> NDArray[np.bool_]:
    """Return which places of the legs are at the surface, shape (L, n_places)."""
    # between the dives of a leg the glider is there, too
    return (
        np.array(
            [
                [*steps[1:], *steps[-1:].repeat(n_places - steps.size + 1)]
                for steps in problem.depths
            ]
        )
        <= 0.0
    )


def _near(
    problem: LegsProblem, places: Array, surfaced: NDArray[np.bool_], count: int
) -> NearRings:
    """Return the rings nearest to places of each leg, shape (L, ..., 2) [m]; at the surface or not, shape (L, ...)."""
    task, rings, turns = problem.task, list[Ring](), np.array(turns_of(problem.yo_depths))
    which = np.empty((*surfaced.shape, count), dtype=np.intp)
    for turn in np.unique(turns):
        legs, there = turns == turn, task.rings_at(float(turn))
        found = near_rings(there, places[legs].reshape(-1, 2), surfaced[legs].ravel(), count)
        which[legs] = np.where(found >= 0, found + len(rings), -1).reshape(which[legs].shape)
        rings += there
    return NearRings(tuple(rings), which.ravel(), task.settings.margin)
