"""Whether the stated errors hold: innovations by dive and through time, their distribution, the decrease of the error."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from scipy.stats import chi2, norm

from replay_kit.core.arrays import Array
from replay_kit.results.views.along_track import mean_current_topics
from replay_kit.results.views.contents import Contents
from replay_kit.results.views.slices import CurrentSlices
from replay_kit.results.views.trust import Calibration, calibration, error_through_time
from replay_kit.show.plots.current_map import At
from replay_kit.show.plots.panel import Panel, Panels, missing
from replay_kit.show.plots.section import date_axis
from replay_kit.show.plots.style import FIRST, FOURTH, INK, SECOND, SOFT, THIRD

_LINES = ("-", "--", ":", "-.")
_COLORS = (FIRST, SECOND, THIRD, FOURTH)
# Lines of depths in one panel, and bins of the histogram.
_DEPTHS, _BINS = 8, 33


def trust_panels(contents: Contents, at: At | None) -> Panels:
    """Return what tells whether the estimate's stated errors hold.

    Args:
        contents: Of the result.
        at: Not used: all measurements count.
    """
    notes, observations = list(contents.notes), contents.result.observations
    if not len(observations):
        why = "The result holds no measurement: there is nothing to compare the estimate with."
        return Panels([missing("Innovations", why)], 1, notes)
    panels, dives = [], contents.outcome.by_dive
    if len(dives) > 1:
        panels.append(Panel("RMS innovation of each dive", partial(_dives, dives), 0.6))
    else:
        notes.append("There are fewer than two dives to predict from each other.")
    panels.append(Panel("normalised innovation squared", partial(_nis, contents), 0.6))
    found = calibration(contents.result.innovations)
    if found.standardized.size:
        panels.append(
            Panel("innovations over their standard deviation", partial(_histogram, found), 0.6)
        )
    slices = contents.slices
    if (
        slices is not None
        and slices.time_ns.size > 1
        and np.isfinite(error_through_time(slices)).any()
    ):
        panels.append(Panel("RMS standard error of the region", partial(_errors, slices), 0.6))
    else:
        notes.append(
            "Fewer than two grids with a standard error were published: how the error decreased is not known."
        )
    return Panels(panels, 2, notes)


def _dives(dives: Sequence[Mapping[str, Any]], axes: Axes) -> None:
    numbers = [dive["dive"] for dive in dives]
    for key, name, color, marker in (
        ("rms_innovation_prior", "ensemble alone", SECOND, "^--"),
        ("rms_innovation_predicted", "estimate before the dive", FIRST, "o-"),
    ):
        values = [np.nan if dive[key] is None else dive[key] for dive in dives]
        axes.plot(numbers, values, marker, color=color, markersize=2.5, label=name)
    axes.set(xlabel="dive", ylabel="RMS innovation [m s$^{-1}$]", ylim=(0.0, None))
    axes.legend(loc="best")


def _nis(contents: Contents, axes: Axes) -> None:
    table = contents.result.observations
    used = table[table["dof"] > 0]
    dof, accepted = used["dof"].to_numpy(np.float64), used["accepted"].to_numpy(bool)
    ratio = used["nis"].to_numpy(np.float64) / dof
    times = used.index.to_numpy()
    of_dive = (
        used["source_topic"]
        .isin(mean_current_topics(table, contents.result.innovations))
        .to_numpy(bool)
    )
    for here, marker, color, name in (
        (accepted & ~of_dive, "o", FIRST, "profiles"),
        (accepted & of_dive, "s", FOURTH, "mean currents"),
        (~accepted, "x", SECOND, "rejected"),
    ):
        if here.any():
            axes.plot(
                times[here],
                ratio[here],
                marker,
                color=color,
                markersize=1.8,
                linestyle="none",
                label=name,
            )
    if dof.size:
        typical = float(np.median(dof))
        low, high = (float(chi2.ppf(share, typical) / typical) for share in (0.025, 0.975))
        axes.axhspan(
            low,
            high,
            color=THIRD,
            alpha=0.2,
            linewidth=0.0,
            label=f"95 % of {typical:g} degrees of freedom",
        )
    axes.axhline(1.0, color=SOFT, linewidth=0.6)
    axes.set_ylabel("NIS per degree of freedom")
    date_axis(axes)
    axes.legend(loc="best")


def _histogram(found: Calibration, axes: Axes) -> None:
    edges = np.linspace(-4.0, 4.0, _BINS)
    axes.hist(
        np.clip(found.standardized, -4.0, 4.0),
        edges.tolist(),
        density=True,
        color=FIRST,
        alpha=0.6,
        label="found",
    )
    fine: Array = np.linspace(-4.0, 4.0, 161)
    axes.plot(fine, norm.pdf(fine), color=INK, label="expected")
    within = f"{100.0 * found.coverage[1.0]:.0f} % within 1 (68 %)\n{100.0 * found.coverage[2.0]:.0f} % within 2 (95 %)"
    axes.text(
        0.02,
        0.97,
        f"mean {found.mean:+.2f}\nstd {found.std:.2f}\n{within}",
        transform=axes.transAxes,
        va="top",
        fontsize=6.0,
    )
    axes.set(xlabel="standardised innovation", ylabel="density", xlim=(-4.0, 4.0))
    axes.legend(loc="upper right")


def _errors(slices: CurrentSlices, axes: Axes) -> None:
    errors, times = error_through_time(slices), slices.time_ns.astype("datetime64[ns]")
    shown = np.unique(
        np.linspace(0, slices.depths.size - 1, min(_DEPTHS, slices.depths.size)).astype(int)
    )
    for number, k in enumerate(shown):
        look: Any = {"color": _COLORS[number % 4], "linestyle": _LINES[number % 4]}
        axes.plot(
            times, errors[k], marker="o", markersize=2.0, label=f"{slices.depths[k]:g} m", **look
        )
    axes.set(ylabel="standard error [m s$^{-1}$]", ylim=(0.0, None))
    date_axis(axes)
    axes.legend(loc="best", ncols=2)
