"""Along the track: the section of bins as means over cells, and the mean currents of the dives as charts."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.results.views.along_track import BinsAlongTrack, MeanCurrents
from replay_kit.show.figures.values import Axis, Chart, Mark, Panel

#: Most columns and rows of the section, and profiles that a column averages where there are enough.
_COLUMNS, _ROWS, _PROFILES_A_COLUMN = 160, 40, 3
COMPONENTS = ("eastward", "northward")
#: Quantities of ``gridded``, and those of a smoothed result.
QUANTITIES = ("measured", "estimated", "measured minus estimated", "standard error")
_SMOOTHED = (
    "measured",
    "estimated before smoothing",
    "smoothed",
    "measured minus before",
    "measured minus smoothed",
    "standard error",
)


def quantities_of(bins: BinsAlongTrack) -> tuple[tuple[str, ...], Array]:
    """Return what sections show of bins, and its values [m/s], shape (quantities, n, 2), local east and north.

    Of a smoothed result the estimate before smoothing stands beside that after it.
    """
    measured = bins.estimated + bins.residual
    if not np.isfinite(bins.replayed).any():
        return QUANTITIES, np.stack([measured, bins.estimated, bins.residual, bins.standard_error])
    each = (
        measured,
        bins.replayed,
        bins.estimated,
        measured - bins.replayed,
        bins.residual,
        bins.standard_error,
    )
    return _SMOOTHED, np.stack(each)


def limits_of(names: Sequence[str], values: Array) -> list[float]:
    """Return the ends of the colours of quantities [m/s]: velocities share one scale, and so do differences.

    Args:
        names: Of ``quantities_of``.
        values: shape (quantities, ...) [m/s].
    """
    kinds = [_kind(name) for name in names]
    return [
        _limit(
            np.concatenate([values[k].ravel() for k, other in enumerate(kinds) if other == kind])
        )
        for kind in kinds
    ]


def _kind(name: str) -> str:
    return (
        "error" if name == "standard error" else "difference" if " minus " in name else "velocity"
    )


@dataclass(frozen=True, slots=True, eq=False)
class SectionGrid:
    """A section along the track, as means over cells of time and depth.

    Attributes:
        time_ns: Of the columns [ns, UTC].
        depths: Of the rows [m].
        names: Of the quantities.
        values: shape (quantities, 2, rows, columns) [m/s], each east and north; NaN in empty cells.
        limits: Ends of the colours of the quantities [m/s].
    """

    time_ns: NDArray[np.int64]
    depths: Array
    names: tuple[str, ...]
    values: Array
    limits: Sequence[float]

    @property
    def shown(self) -> list[int]:
        """The quantities that have values."""
        return [k for k, values in enumerate(self.values) if np.isfinite(values).any()]

    def colors(self, quantity: int) -> tuple[str, float, float]:
        """Return the colour scale of a quantity, and the values at its ends [m/s]."""
        limit = self.limits[quantity]
        if _kind(self.names[quantity]) == "error":
            return "amp", 0.0, limit
        return "balance", -limit, limit


def gridded(bins: BinsAlongTrack) -> SectionGrid:
    """Return the means of bins over cells of time and depth, of the quantities of ``quantities_of``."""
    first, last = int(bins.time_ns.min()), int(bins.time_ns.max())
    columns = min(
        _COLUMNS,
        max(1, bins.profiles // _PROFILES_A_COLUMN if bins.profiles > 60 else bins.profiles),
    )
    width = max(1.0, (last - first) / columns)
    deepest = max(float(bins.depth.max()), 1.0)
    rows = _rows(bins, deepest)
    at = np.minimum(((bins.time_ns - first) / width).astype(np.intp), columns - 1)
    row = np.clip((bins.depth / deepest * rows).astype(np.intp), 0, rows - 1)
    names, values = quantities_of(bins)
    out = np.full((len(values), 2, rows, columns), np.nan)
    cell = row * columns + at
    for panel in range(len(values)):
        for axis in range(2):
            known = np.isfinite(values[panel, :, axis])
            count = np.bincount(cell[known], minlength=rows * columns)
            total = np.bincount(
                cell[known], weights=values[panel, known, axis], minlength=rows * columns
            )
            mean = np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)
            out[panel, axis] = mean.reshape(rows, columns)
    time_ns = first + np.rint(width * (np.arange(columns) + 0.5)).astype(np.int64)
    depths = deepest * (np.arange(rows) + 0.5) / rows
    return SectionGrid(time_ns, depths, names, out, limits_of(names, out))


def _rows(bins: BinsAlongTrack, deepest: float) -> int:
    """Return the number of rows: none is thinner than the bins are apart, or some would be empty."""
    steps = np.diff(bins.depth)[np.diff(bins.time_ns) == 0]
    apart = float(np.median(np.abs(steps))) if steps.size else deepest
    return int(np.clip(deepest / max(apart, 1e-3), 1, _ROWS))


def _limit(values: Array) -> float:
    known = np.abs(values[np.isfinite(values)])
    return float(f"{max(np.quantile(known, 0.99), 1e-3):.2g}") if known.size else 1.0


def mean_current_chart(means: MeanCurrents) -> Chart:
    """Return the mean currents of dives through time, measured, corrected and estimated, a panel for each component."""
    parts = _parts(means)
    table: dict[str, Any] = {"dive": means.dive, "end": means.time_ns.astype("datetime64[ns]")}
    for k, component in enumerate(COMPONENTS):
        for part, values in parts.items():
            table[f"{part.replace(' ', '_')}_{component}_m_s"] = values[:, k]
        table[f"standard_deviation_{component}_m_s"] = means.standard_error[:, k]
    panels = [
        Panel(
            f"dives' mean current, {component}",
            Axis(component, "m/s"),
            [_mean_mark(part, component) for part in parts],
            level=0.0,
        )
        for component in COMPONENTS
    ]
    corrected = "Open circles: corrected for the flight model's error, as the estimate uses them. "
    caption = (
        "Points: mean current measured over each dive; bars: one standard deviation expected before the update. "
        f"{corrected if 'corrected' in parts else ''}Line: mean of the estimate "
        "over the positions of the dive, just after the update. Points that stay on one side of the line show a bias."
    )
    names = " and ".join(parts).capitalize()
    return Chart(
        "mean-currents",
        "Mean currents of the dives",
        Axis("end of the dive (UTC)"),
        panels,
        caption,
        f"{names} mean current of {means.time_ns.size} dives, eastward and northward, against time.",
        {"mean_currents": table},
        480,
    )


def _parts(means: MeanCurrents) -> dict[str, Array]:
    """Return what the result holds of the mean currents [m/s], each shape (n, 2), by name."""
    corrected = {"corrected": means.corrected} if np.isfinite(means.corrected).any() else {}
    return {"measured": means.measured, **corrected, "estimated": means.estimated}


def _mean_mark(part: str, component: str) -> Mark:
    y = f"mean_currents.{part.replace(' ', '_')}_{component}_m_s"
    about: dict[str, Any] = {
        "hover": f"dive %{{text}}: %{{y:.3f}} m/s<extra>{part}, {component}</extra>",
        "text": "mean_currents.dive",
    }
    if part == "estimated":
        return Mark("joined", "mean_currents.end", y, part, "one", "square", size=4.0, **about)
    about["error"] = f"mean_currents.standard_deviation_{component}_m_s"
    symbol = "circle-open" if part == "corrected" else "circle"
    return Mark("points", "mean_currents.end", y, part, "two", symbol, size=7.0, **about)
