"""Rows of the tables as frozen values, for console, CSV and JSON."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any

import numpy as np

from replay_kit.studies.paper.text import NAN, grouped

TRUTH, AVERAGED = "truth", "depth_averaged_truth"
#: Names of methods and flows in tables and legends.
LABELS = {
    TRUTH: "truth",
    AVERAGED: "depth-averaged truth",
    "naive3d": "naive 3D basis",
    "paper": "2.5D paper, l = 10 km",
    "paper_cells": "2.5D paper, l = 1.16 cells",
    "default": "2.5D default",
    "nearest": "nearest member",
    "ensemble_mean": "ensemble mean",
}


@dataclass(frozen=True, slots=True)
class ErrorRow:
    """One estimator in Table I or II; over several truths the median and the worst.

    Attributes:
        method: ``naive3d``, ``paper``, ``paper_cells``, ``default``, ``nearest`` or ``ensemble_mean``.
        rung: Number of modes: ``full``, ``members`` or a number; empty without a choice.
        modes: Number r of basis flows per level, or of whole basis flows of ``naive3d``; None without a basis.
        elements: Number of elements of the basis, the paper's "elements in H"; None without a basis.
        rel_error: RMSE over the truth's RMS speed.
        rmse: RMS length of the error vector over the truth's wet grid points [m/s].
        bound: Least RMSE of any flow in the method's span [m/s].
        rel_error_worst: Relative error of the worst truth.
        rmse_worst: RMSE of the worst truth [m/s].
        rel_error_by_truth: Relative error of each truth.
        seconds: Wall time to build the estimator and assimilate all profiles [s], mean over truths.
        note: Reason for missing figures.
    """

    method: str
    rung: str
    modes: int | None
    elements: int | None
    rel_error: float
    rmse: float
    bound: float
    rel_error_worst: float
    rmse_worst: float
    rel_error_by_truth: tuple[float, ...]
    seconds: float
    note: str


@dataclass(frozen=True, slots=True)
class SparseRow:
    """Estimate after some profiles of Table II; over several truths the median and the worst.

    Attributes:
        pings: Number of profiles so far.
        method: As in ``ErrorRow``.
        modes: Basis flows per level; None without a basis.
        rel_error: RMSE over the truth's RMS speed.
        rel_error_worst: Relative error of the worst truth.
        rel_error_by_truth: Relative error of each truth.
    """

    pings: int
    method: str
    modes: int | None
    rel_error: float
    rel_error_worst: float
    rel_error_by_truth: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class GlideRow:
    """Plans made on one flow and flown in the truth (Table III).

    Attributes:
        flow: ``truth``, ``depth_averaged_truth`` or a method.
        pairs: Number of starts and targets.
        median: Median closest approach to the target [m].
        lower_quartile: Lower quartile [m].
        upper_quartile: Upper quartile [m].
        median_low: Lower end of the bootstrap 90 % interval of the median [m].
        median_high: Upper end [m].
        within_250: Number of pairs within 250 m.
        seconds: Wall time of all plans and flights [s].
        closest_approach: By pair [m].
        note: Reason for missing figures.
    """

    flow: str
    pairs: int = 0
    median: float = NAN
    lower_quartile: float = NAN
    upper_quartile: float = NAN
    median_low: float = NAN
    median_high: float = NAN
    within_250: int = 0
    seconds: float = 0.0
    closest_approach: tuple[float, ...] = ()
    note: str = ""


def over_truths(tables: Sequence[Sequence[ErrorRow]]) -> tuple[ErrorRow, ...]:
    """Return medians and worst over truths of rows of equal method and number of modes.

    Failed truths are excluded from the figures and counted in the note.

    Args:
        tables: One table per truth.
    """
    return tuple(
        _over_truths(alike)
        for alike in grouped(
            chain.from_iterable(tables), lambda row: (row.method, row.rung)
        ).values()
    )


def sparse_over_truths(tables: Sequence[Sequence[SparseRow]]) -> tuple[SparseRow, ...]:
    """Return medians and worst over truths of rows of equal method and number of pings.

    Args:
        tables: One table per truth.
    """
    return tuple(
        replace(
            alike[0],
            rel_error=float(np.median([row.rel_error for row in alike])),
            rel_error_worst=max(row.rel_error_worst for row in alike),
            rel_error_by_truth=tuple(value for row in alike for value in row.rel_error_by_truth),
        )
        for alike in grouped(
            chain.from_iterable(tables), lambda row: (row.pings, row.method)
        ).values()
    )


def _over_truths(alike: Sequence[ErrorRow]) -> ErrorRow:
    if len(alike) == 1:
        return alike[0]
    failed = [row.note for row in alike if row.note]
    measured = [row for row in alike if not row.note] or alike
    medians: dict[str, Any] = {
        name: float(np.median([getattr(row, name) for row in measured]))
        for name in ("rel_error", "rmse", "bound")
    }
    return replace(
        alike[0],
        **medians,
        modes=max((row.modes for row in alike if row.modes is not None), default=None),
        elements=max((row.elements for row in alike if row.elements is not None), default=None),
        rel_error_worst=max(row.rel_error_worst for row in measured),
        rmse_worst=max(row.rmse_worst for row in measured),
        rel_error_by_truth=tuple(value for row in alike for value in row.rel_error_by_truth),
        seconds=float(np.mean([row.seconds for row in alike])),
        note=f"{len(failed)} of {len(alike)} truths: {failed[0]}" if failed else "",
    )
