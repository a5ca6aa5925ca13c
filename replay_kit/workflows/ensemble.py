"""Ensembles: fit of the prior, written as settings (``fit``), and description of forecast files (``info --ensemble``)."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from replay_kit.config.run import EstimatorConfig
from replay_kit.core import __version__
from replay_kit.core.errors import ForecastError
from replay_kit.core.files.atomic import write_whole
from replay_kit.core.grid import Ensemble
from replay_kit.core.words.progress import announce
from replay_kit.estimator.basis.modes import build_basis
from replay_kit.estimator.basis.slices import correlation_length
from replay_kit.estimator.prior.factor import PriorSettings
from replay_kit.estimator.prior.fit import FitRow, Members, best, fit_settings
from replay_kit.forecast.describe import Description
from replay_kit.show.text import print_table


@dataclass(frozen=True, slots=True)
class Fitted:
    """Settings tried and chosen by a fit.

    Attributes:
        rows: All trials, in order.
        chosen: Settings with the lowest score.
        length: The ensemble's correlation length [m].
        ensemble: File of the ensemble.
        left_out: Number of members left out in turn.
    """

    rows: tuple[FitRow, ...]
    chosen: PriorSettings
    length: float
    ensemble: str
    left_out: int


def fit_prior(ensemble: Ensemble, config: EstimatorConfig, left_out: int) -> Fitted:
    """Return the settings of the prior that best predict members left out.

    Args:
        ensemble: All members.
        config: Number of modes, kernel, nugget.
        left_out: Number of members left out in turn; all when there are fewer.

    Raises:
        ForecastError: There are fewer than four members.
    """
    if ensemble.n_members < 4:
        raise ForecastError(
            f"{ensemble.source}: fitting leaves members out and needs at least 4, got {ensemble.n_members}"
        )
    announce("computing the basis")
    basis, length = build_basis([ensemble], config), correlation_length(ensemble)
    members = Members.leading(basis.member_weights, basis.at_nodes, basis.grid.nodes)
    rows = fit_settings(members, length, left_out)
    return Fitted(rows, best(rows), length, ensemble.source, min(left_out, ensemble.n_members))


def write_fit(fitted: Fitted, path: Path) -> None:
    """Write the chosen settings as TOML that ``--config`` takes."""
    write_whole(
        path,
        f"""# Fitted by replay-kit {__version__} to {fitted.ensemble}:
# {fitted.left_out} members left out in turn, {len(fitted.rows)} settings tried, correlation length {fitted.length:.0f} m.
[estimator]
sample_share = {fitted.chosen.sample_share}
shift_distance = {fitted.chosen.shift:.1f}
localisation_radius = {fitted.chosen.radius:.1f}
""",
    )


def fit_json(fitted: Fitted) -> dict[str, Any]:
    """Return the fit for JSON."""
    return asdict(fitted)


def print_fit(fitted: Fitted, console: Console) -> None:
    """Print all trials and the chosen settings."""
    rows = (
        (*_figures(row.settings), f"{row.score:.4f}", f"{row.coverage90:.3f}")
        for row in fitted.rows
    )
    print_table(
        console, None, ("sample share", "shift [km]", "radius [km]", "score", "cov. 90"), rows
    )
    share, shift, radius = _figures(fitted.chosen)
    chosen = (
        f"Chosen: sample share {share}, members shifted by {shift} km, taper to zero at {radius} km"
    )
    console.print(f"{chosen}; correlation length {fitted.length / 1e3:.1f} km")


def _figures(settings: PriorSettings) -> tuple[str, str, str]:
    return (
        f"{settings.sample_share:.2f}",
        f"{settings.shift / 1e3:.1f}",
        f"{settings.radius / 1e3:.1f}",
    )


_MOST_LABELS = 6


def ensemble_json(found: Description) -> dict[str, Any]:
    """Return the description of an ensemble for JSON."""
    ensemble, check = found.ensemble, found.check
    return {
        "files": found.source,
        "grid_files": [path.name for path in found.grids],
        "use": found.use,
        "members_rule": found.rule or None,
        "members": [] if ensemble is None else list(ensemble.members),
        "velocities": list(found.names),
        "arrangement": found.arrangement,
        "axes": None
        if check is None
        else {"read_along": check.axes, "because": check.why, "largest_angle_degrees": check.angle},
        "axes_check": None
        if check is None
        else {
            "residual": check.residual,
            "geostrophic_phase_degrees": check.phase,
            "contradicted": check.contradicted,
        },
        "time": None if ensemble is None else _time(ensemble),
        "grid": None if ensemble is None else list(ensemble.grid.longitude.shape),
        "levels": [] if ensemble is None else ensemble.grid.levels.tolist(),
        "wet_share": None if ensemble is None else float(ensemble.grid.wet[0].mean()),
        "notes": [] if ensemble is None else list(ensemble.notes),
    }


def print_ensemble(found: Description, console: Console) -> None:
    """Print the description of an ensemble."""
    table = Table("forecast", found.source, title_justify="left")
    for path in found.grids if found.ensemble is not None else ():
        table.add_row("file of the grid, no current", path.name)
    ensemble, check = found.ensemble, found.check
    if ensemble is not None and check is not None:
        grid = ensemble.grid
        table.add_row("velocities", f"{found.names[0]}, {found.names[1]}: {found.arrangement}")
        table.add_row(
            "axes",
            f"{_AXES[check.axes]} ({check.why}); grid turned by up to {check.angle:.1f} degrees; {check.figures}",
        )
        table.add_row(
            "members",
            f"{ensemble.n_members} by --members {found.rule}" if found.rule else "one field",
        )
        for label in _shortened(ensemble.members):
            table.add_row("", label)
        table.add_row("time", _time(ensemble) or "none stated")
        table.add_row(
            "grid",
            f"{grid.longitude.shape[0]} x {grid.longitude.shape[1]} points, {grid.longitude.min():.3f}..{grid.longitude.max():.3f} E, "
            f"{grid.latitude.min():.3f}..{grid.latitude.max():.3f} N, {100 * grid.wet[0].mean():.0f} % of the first level water",
        )
        table.add_row("levels", f"{grid.levels.size}, {grid.levels[0]:g} to {grid.levels[-1]:g} m")
        table.add_row("speed", f"{np.sqrt(2.0) * ensemble.component_rms:.3f} m/s rms")
    console.print(table)
    console.print(f"Use: {found.use}")
    for note in () if ensemble is None else ensemble.notes:
        console.print(f"Note: {note}")


_AXES = {"grid": "along the grid, turned to true east and north", "true": "true east and north"}


def _time(ensemble: Ensemble) -> str | None:
    return (
        None
        if ensemble.time_ns is None
        else f"{np.datetime_as_string(np.datetime64(ensemble.time_ns, 'ns'), unit='s')}Z"
    )


def _shortened(labels: tuple[str, ...]) -> list[str]:
    """Return the first and last labels, and the number between them."""
    if len(labels) <= _MOST_LABELS:
        return list(labels)
    half = _MOST_LABELS // 2
    return [*labels[:half], f"... {len(labels) - 2 * half} more ...", *labels[-half:]]
