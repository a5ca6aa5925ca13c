"""Fit an ensemble's prior and write it as settings: the composer of ``replay-kit fit``."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.atomic import write_whole
from replay_kit.core.errors import ForecastError
from replay_kit.core.grid import Ensemble
from replay_kit.core.progress import announce, counted
from replay_kit.core.version import __version__
from replay_kit.estimator.basis.modes import build_basis
from replay_kit.estimator.basis.slices import correlation_length
from replay_kit.estimator.prior.fit import FitRow, best, fit_settings, fit_steps, members_in_basis
from replay_kit.estimator.prior.hybrid import PriorSettings
from replay_kit.show.text import print_table


@dataclass(frozen=True, slots=True)
class Fitted:
    """What was tried and chosen.

    Attributes:
        rows: All that was tried, in that order.
        chosen: The settings of the least score.
        length: The ensemble's correlation length [m].
        ensemble: Its file.
        left_out: Number of members left out in turn.
    """

    rows: tuple[FitRow, ...]
    chosen: PriorSettings
    length: float
    ensemble: str
    left_out: int


def fit_prior(ensemble: Ensemble, config: EstimatorConfig, left_out: int) -> Fitted:
    """Return the prior's settings that tell members left out best.

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
    members = members_in_basis(build_basis(ensemble, config))
    length = correlation_length(ensemble)
    rows = fit_settings(
        members,
        length,
        left_out,
        counted("leaving members out", fit_steps(ensemble.n_members, left_out)),
    )
    return Fitted(
        tuple(rows), best(rows), length, ensemble.source, min(left_out, ensemble.n_members)
    )


def write_fit(fitted: Fitted, path: Path) -> None:
    """Write the chosen settings as TOML that ``--config`` takes."""
    text = f"""# Fitted by replay-kit {__version__} to {fitted.ensemble}:
# {fitted.left_out} members left out in turn, {len(fitted.rows)} settings tried, correlation length {fitted.length:.0f} m.
[estimator]
sample_share = {fitted.chosen.sample_share}
shift_distance = {fitted.chosen.shift:.1f}
localisation_radius = {fitted.chosen.radius:.1f}
"""
    write_whole(path, text)


def fit_json(fitted: Fitted) -> dict[str, Any]:
    """Return the JSON object of ``--json``."""
    return asdict(fitted)


def print_fit(fitted: Fitted, console: Console) -> None:
    """Print all that was tried, and what was chosen."""
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
