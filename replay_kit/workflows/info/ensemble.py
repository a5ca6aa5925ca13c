"""Description of forecast files, for people and as JSON."""

from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from replay_kit.core.grid import Ensemble
from replay_kit.forecast.describe import Description

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
