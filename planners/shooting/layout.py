"""Where the unknowns, the constraints and the entries of their derivatives are in a mission's program.

The unknowns are, leg after leg, where and when it ends [km, km, h], its heading and its glide angle [rad]; then slack variables: of each
goal what is missed towards east, north, west and south [km], of the reference path, of the half-planes [km]. The constraints are those of
each leg's end (east, north, time), of each goal, of the half-planes of each place, of each place's distance from the reference path.
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from planners.shooting.frames import GIVEN
from replay_kit.core.arrays import Array

#: Unknowns of each leg.
EACH = 5


@dataclass(frozen=True, slots=True)
class Layout:
    """Where the unknowns and constraints of a mission are.

    Attributes:
        n_legs: Number of legs.
        goals: In which leg each goal is met, counted from 0, and after which of its steps, from 1; 0 for its end.
        n_places: Places of a leg at which half-planes and the reference path count.
        n_planes: Half-planes of each place.
        has_reference: Whether there is a reference path.
        changing: Whether the current changes.
    """

    n_legs: int
    goals: tuple[tuple[int, int], ...]
    n_places: int
    n_planes: int
    has_reference: bool
    changing: bool

    @property
    def n_unknowns(self) -> int:
        """Number of unknowns."""
        return (
            self.slack_at + 4 * len(self.goals) + int(self.has_reference) + int(self.n_planes > 0)
        )

    @property
    def slack_at(self) -> int:
        """Position of the first slack."""
        return EACH * self.n_legs

    @property
    def n_equal(self) -> int:
        """Number of constraints that are equations."""
        return 3 * self.n_legs + 2 * len(self.goals)

    @property
    def n_limited(self) -> int:
        """Number of the others."""
        return (self.n_planes + int(self.has_reference)) * self.n_places * self.n_legs

    @property
    def columns(self) -> NDArray[np.intp]:
        """Positions, shape (L, Q), of what each leg depends on among the unknowns; -1 for the start of the first, which is known."""
        legs = EACH * np.arange(self.n_legs)[:, None]
        before = np.where(legs > 0, legs - EACH + np.arange(3), -1)
        columns = np.concatenate([before[:, :2], legs + np.array([3, 4]), before[:, 2:]], axis=1)
        return columns if self.changing else columns[:, :GIVEN]


class Scatter:
    """Puts the entries of a sparse matrix, given in any order with positions of -1 left out, into the order of compressed columns."""

    def __init__(self, rows: Array, columns: Array, shape: tuple[int, int]) -> None:
        """Order entries at given rows and columns, shape (n,) each."""
        kept = np.flatnonzero((rows >= 0) & (columns >= 0))
        self._order = kept[np.lexsort((rows[kept], columns[kept]))]
        self.sparsity = ca.Sparsity.triplet(*shape, rows[kept].tolist(), columns[kept].tolist())

    def __call__(self, *parts: Array) -> Array:
        """Return the entries, in order, of parts one after the other."""
        return np.concatenate([np.ravel(part) for part in parts])[self._order]


def jacobian_scatter(layout: Layout) -> Scatter:
    """Return where the entries of the Jacobian are, in the order in which ``MissionFunctions`` gives them."""
    n_legs, columns, found = layout.n_legs, layout.columns, list[tuple[Any, Any]]()
    legs = np.arange(n_legs)
    found.append((3 * legs[:, None, None] + np.arange(2)[:, None], columns[:, None]))
    found.append((3 * legs[:, None] + np.arange(3), EACH * legs[:, None] + np.arange(3)))
    found.append((3 * legs + 2, np.where(legs > 0, EACH * legs - 3, -1)))
    found.append((3 * legs + 2, EACH * legs + 4))
    for g, (leg, step) in enumerate(layout.goals):
        rows = 3 * n_legs + 2 * g + np.arange(2)
        found.append((rows[:, None], columns[leg]) if step else (rows, EACH * leg + np.arange(2)))
    rows = 3 * n_legs + 2 * np.arange(len(layout.goals))[:, None] + np.array([0, 1, 0, 1])
    found.append((rows, layout.slack_at + np.arange(4 * len(layout.goals)).reshape(-1, 4)))
    at, per_leg = layout.n_equal, columns[:, None, None]
    if layout.n_planes:
        of_planes = at + np.arange(n_legs * layout.n_places * layout.n_planes).reshape(
            n_legs, layout.n_places, layout.n_planes
        )
        found += [(of_planes[..., None], per_leg), (of_planes, np.array(layout.n_unknowns - 1))]
        at += of_planes.size
    if layout.has_reference:
        of_places = at + np.arange(n_legs * layout.n_places).reshape(n_legs, layout.n_places)
        found += [
            (of_places[..., None], per_leg[:, 0]),
            (of_places, np.array(layout.slack_at + 4 * len(layout.goals))),
        ]
    return _scatter(found, (layout.n_equal + layout.n_limited, layout.n_unknowns))


def hessian_scatter(layout: Layout) -> Scatter:
    """Return where the entries of the Hessian's upper triangle are; those given below it are left out."""
    columns = layout.columns
    slacks = layout.slack_at + np.arange(4 * len(layout.goals)).reshape(-1, 4)
    found: list[tuple[Any, Any]] = [(one[:, :, None], one[:, None]) for one in (columns, slacks)]
    if layout.has_reference:
        found.append((np.array([slacks.max() + 1]),) * 2)
    return _scatter(found, (layout.n_unknowns,) * 2, upper=True)


def _scatter(found: list[tuple[Any, Any]], shape: tuple[int, int], upper: bool = False) -> Scatter:
    pairs = [[one.ravel() for one in np.broadcast_arrays(rows, columns)] for rows, columns in found]
    rows, columns = (np.concatenate([pair[k] for pair in pairs]) for k in (0, 1))
    return Scatter(np.where(rows <= columns, rows, -1) if upper else rows, columns, shape)
