"""The figures of the paper, each as PNG and SVG; the same study gives the same bytes."""

from collections.abc import Callable, Iterator

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from replay_kit.core.arrays import Array
from replay_kit.core.flow.depth import depth_weights
from replay_kit.estimator.basis.modes import Basis, build_basis
from replay_kit.studies.paper.figures_flow import glides_3d, glides_top, truth_3d, truth_top
from replay_kit.studies.paper.run import PaperTables, Shown
from replay_kit.studies.paper.tables import methods_with_modes
from replay_kit.studies.paper.views import from_above, in_3d, metres, shape_of, slice_3d
from replay_kit.studies.reports.charts import EAST, FLOW_STYLES, LABELS, NORTH
from replay_kit.studies.reports.page import Drawn, saved
from replay_kit.studies.reports.tables import grouped
from replay_kit.studies.scoring import preset_config

_MODES_SHOWN = (1, 2, 10, 30)
# What is smaller than this over the largest is rounding, no property of the slices.
_ROUNDING = 1e-15


def draw(tables: PaperTables, shown: Shown) -> Iterator[tuple[str, Drawn]]:
    """Yield the name of every figure, and itself as PNG and SVG.

    Args:
        tables: The results.
        shown: Truth, profiles and glides.
    """
    bases = _bases(shown)
    drawn: dict[str, Callable[[], Figure]] = {
        "singular_values": lambda: _singular_values(bases),
        "modes_top": lambda: _modes_top(bases),
        "modes_3d": lambda: _modes_3d(bases),
        "truth_3d": lambda: truth_3d(shown),
        "truth_top": lambda: truth_top(shown),
        "sparse": lambda: _sparse(tables),
        "glides_3d": lambda: glides_3d(shown),
        "glides_top": lambda: glides_top(shown, tables.target_depth),
    }
    for name, make in drawn.items():
        yield name, saved(make, "png", "svg")


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


def _singular_values(bases: dict[str, Basis]) -> Figure:
    figure = Figure(figsize=(8.0, 4.6), layout="constrained")
    axes = figure.subplots()
    for method, basis in bases.items():
        values = basis.singular_values
        kept = values[values > _ROUNDING * values[0]]
        label = f"{LABELS[method]} (largest {kept[0]:.3g})"
        axes.semilogy(
            np.arange(1, kept.size + 1),
            kept / kept[0],
            color=FLOW_STYLES[method].colour,
            label=label,
        )
    axes.set(
        title="Singular values: of latents (paper), of velocities in m/s (default)",
        xlabel="mode",
        ylabel="singular value / largest",
    )
    axes.grid(alpha=0.3)
    axes.legend()
    return figure


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


def _modes_3d(bases: dict[str, Basis]) -> Figure:
    figure = Figure(figsize=(6.0 * len(bases) + 1.0, 5.8), layout="constrained")
    colours = Normalize(0.0, 1.0)
    for k, (method, basis) in enumerate(bases.items(), start=1):
        levels = basis.grid.levels
        level = int(np.argmin(np.abs(levels - 0.35 * levels[-1])))
        above, here, below = (
            float(levels[np.clip(level + step, 0, levels.size - 1)]) for step in (-1, 0, 1)
        )
        depths = np.unique([(above + here) / 2.0, here, (here + below) / 2.0])
        shares = depth_weights(basis.depth_functions, depths, levels)[:, level]
        ends = (above, below) if above < below else (0.5 * here, 1.5 * here)
        axes = in_3d(figure, (1, len(bases), k), basis.grid, ends)
        mode = _mode(basis, 1)
        for depth, share in zip(depths[::-1], shares[::-1], strict=True):
            slice_3d(axes, basis.grid, share * mode, float(depth), colours)
        axes.set_title(
            f"{LABELS[method]}: mode 1 of level {metres(here)} m\nat {', '.join(map(metres, depths))} m"
        )
    figure.colorbar(
        ScalarMappable(norm=colours, cmap="viridis"),
        ax=figure.axes,
        label="speed / largest of the mode",
        shrink=0.6,
    )
    return figure


def _mode(basis: Basis, number: int) -> Array:
    """Return a mode's velocity at the grid's points over its largest speed, shape (J, I, 2); NaN on land."""
    nodes = basis.grid.nodes
    at_nodes = basis.horizontal.velocity(nodes, basis.modes[:, number - 1 : number])[:, :, 0].T
    out = np.full((*basis.grid.wet[0].shape, 2), np.nan)
    out[basis.grid.wet[0]] = at_nodes / np.hypot(*at_nodes.T).max()
    return out


def _sparse(tables: PaperTables) -> Figure:
    figure = Figure(figsize=(8.0, 5.4), layout="constrained")
    axes = figure.subplots()
    for method, rows in grouped(tables.sparse, lambda row: row.method).items():
        modes = "" if rows[0].modes is None else f", {rows[0].modes} modes"
        style = FLOW_STYLES[method]
        errors = [row.rel_error for row in rows]
        axes.loglog(
            [row.pings for row in rows],
            errors,
            style.line,
            color=style.colour,
            marker=style.marker,
            label=style.label + modes,
        )
    counts = sorted({row.pings for row in tables.sparse})
    axes.set_xticks(counts, [str(n) for n in counts])
    axes.minorticks_off()
    errors = [row.rel_error for row in tables.sparse if np.isfinite(row.rel_error)]
    ticks = [
        value
        for value in (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
        if min(errors) / 2 <= value <= 2 * max(errors)
    ]
    axes.set_yticks(ticks, [f"{value:g}" for value in ticks])
    axes.set(
        title="Error of the estimates on the way through Table II",
        xlabel="pings",
        ylabel="RMSE / RMS speed of the truth",
    )
    axes.grid(alpha=0.3)
    figure.legend(loc="outside lower center", ncols=2)
    return figure
