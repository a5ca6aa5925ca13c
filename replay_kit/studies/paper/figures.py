"""The figures of the paper, each as PNG and SVG; the same study gives the same bytes."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import rotate_to_local, to_local
from replay_kit.estimator.basis.modes import Basis, build_basis
from replay_kit.studies.paper.maps import EAST, NORTH, from_above, glides_top, shape_of, truth_top
from replay_kit.studies.paper.run import Shown
from replay_kit.studies.paper.tables import methods_with_modes
from replay_kit.studies.reports.charts import (
    BLUE,
    FLOW_STYLES,
    LABELS,
    VERMILION,
    Axis,
    Chart,
    FlowStyle,
    Series,
    ticks_of,
)
from replay_kit.studies.reports.page import Drawn, saved
from replay_kit.studies.scoring import preset_config

_MODES_SHOWN = (1, 2, 10, 30)
# What is smaller than this over the largest is rounding, no property of the slices.
_ROUNDING = 1e-15
# Points of a line that has a marker at each.
_FEW = 18
_STYLES = {style.label: style for style in FLOW_STYLES.values()}


def draw(shown: Shown, depth: float, sparse: Chart) -> Iterator[tuple[str, Drawn]]:
    """Yield the name of every figure, and itself as PNG and SVG.

    Args:
        shown: Truth, profiles and glides.
        depth: Of the glides' targets [m].
        sparse: The error against the number of pings.
    """
    bases = _bases(shown)
    drawn: dict[str, Callable[[], Figure]] = {
        "singular_values": lambda: _print_chart(_singular_values(bases)),
        "modes_top": lambda: _modes_top(bases),
        "ping": lambda: _ping(shown),
        "truth_top": lambda: truth_top(shown),
        "sparse": lambda: _print_chart(sparse),
        "glides_top": lambda: glides_top(shown, depth),
    }
    for name, make in drawn.items():
        yield name, saved(make, "png", "svg")


def _print_chart(chart: Chart) -> Figure:
    """Return a chart drawn with the styles of the flows that its series are named after."""
    figure = Figure(figsize=(8.0, 5.0), layout="constrained")
    axes = figure.subplots()
    for series in chart.series:
        style = _STYLES.get(series.label) or FlowStyle(series.label, VERMILION, "o")
        few = style.marker if len(series.x) <= _FEW else None
        look: Any = {"color": style.colour, "marker": few, "linestyle": style.line}
        axes.plot(series.x, series.y, label=series.label, **look)
    if chart.level is not None:
        axes.axhline(chart.level, color="0.6", linestyle=":")
    horizontal, vertical = chart.axes
    axes.set(title=chart.title, xlabel=horizontal.title, ylabel=vertical.title)
    for k, (axis, drawn) in enumerate(zip(chart.axes, (axes.xaxis, axes.yaxis), strict=True)):
        if axis.log:
            drawn.axes.set(**{"xscale" if k == 0 else "yscale": "log"})
            ticks = ticks_of(chart, k)
            drawn.set_ticks(ticks, [f"{tick:.10g}" for tick in ticks])
            drawn.set_minor_locator(NullLocator())
    axes.grid(alpha=0.3)
    figure.legend(loc="outside lower center", ncols=2)
    return figure


def _bases(shown: Shown) -> dict[str, Basis]:
    """Return the bases of those 2.5D methods that can be built, with as many modes as are shown and all singular values."""
    ensemble, config = (
        shown.case.ensemble,
        shown.config.model_copy(update={"modes": max(_MODES_SHOWN)}),
    )
    bases = {}
    for method in methods_with_modes(ensemble.grid):
        try:
            bases[method] = build_basis(ensemble, preset_config(method, ensemble.grid, config))
        except ValueError:
            # the tables' rows say why; the figures show what there is
            continue
    return bases


def _singular_values(bases: dict[str, Basis]) -> Chart:
    series = []
    for method, basis in bases.items():
        values = basis.singular_values
        kept = values[values > _ROUNDING * values[0]] / values[0]
        series.append(Series(LABELS[method], np.arange(1, kept.size + 1).tolist(), kept.tolist()))
    title = "Singular values: of latents (paper), of velocities in m/s (default)"
    axes = Axis("mode [number]"), Axis("singular value / largest [1]", log=True)
    return Chart("singular-values", title, "", axes, tuple(series))


def _modes_top(bases: dict[str, Basis]) -> Figure:
    numbers = [n for n in _MODES_SHOWN if n <= min(basis.n_modes for basis in bases.values())]
    grid = next(iter(bases.values())).grid
    size = (3.5 * len(numbers) + 1.2, (3.1 * shape_of(grid) + 0.55) * len(bases) + 0.6)
    figure = Figure(figsize=size, layout="compressed")
    panels = figure.subplots(len(bases), len(numbers), squeeze=False, sharex=True, sharey=True)
    for row, (method, basis) in zip(panels, bases.items(), strict=True):
        for axes, n in zip(row, numbers, strict=True):
            mesh = from_above(axes, grid, _mode(basis, n), 1.0)
            axes.set_title(f"{LABELS[method]}: mode {n}", fontsize=11)
        row[0].set_ylabel(NORTH)
    for axes in panels[-1]:
        axes.set_xlabel(EAST)
    figure.colorbar(mesh, ax=panels, label="speed / largest of the mode", shrink=0.8, aspect=30)
    return figure


def _mode(basis: Basis, number: int) -> Array:
    """Return a mode's velocity at the grid's points over its largest speed, shape (J, I, 2); NaN on land."""
    nodes = basis.grid.nodes
    at_nodes = basis.horizontal.velocity(nodes, basis.modes[:, number - 1 : number])[:, :, 0].T
    out = np.full((*basis.grid.wet[0].shape, 2), np.nan)
    out[basis.grid.wet[0]] = at_nodes / np.hypot(*at_nodes.T).max()
    return out


def _ping(shown: Shown) -> Figure:
    """Return the components of the first of the profiles with the most bins against depth, and the truth's."""
    ping = max(shown.observations, key=lambda one: int(np.isfinite(one.velocity).all(axis=1).sum()))
    projection = shown.truth.grid.projection
    east, north = to_local(projection, ping.longitude, ping.latitude)
    local = rotate_to_local(projection, ping.longitude, ping.latitude, *ping.velocity.T)
    depths = np.linspace(0.0, float(shown.truth.levels[-1]), 200)
    truth = shown.truth.velocity(float(east), float(north), depths)
    figure = Figure(figsize=(5.5, 6.0), layout="constrained")
    axes = figure.subplots()
    for k, (name, colour, marker) in enumerate((("east", BLUE, "o"), ("north", VERMILION, "s"))):
        axes.plot(truth[:, k], depths, color=colour, label=f"{name}, truth")
        look: Any = {"color": colour, "markersize": 5, "markerfacecolor": "white"}
        axes.plot(local[k], ping.depth, marker, label=f"{name}, measured", **look)
    axes.invert_yaxis()
    axes.grid(alpha=0.3)
    axes.set(xlabel="velocity [m/s]", ylabel="depth [m]", title="The bins of one ping")
    figure.legend(loc="outside lower center", ncols=2)
    return figure
