"""Predictions of dives as tables and JSON."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from replay_kit import __version__
from replay_kit.studies.dives.predict import Surfacing
from replay_kit.studies.dives.run import DivePrediction, DivesResult, rms_length

_TITLES = {"profiles": "RMS length of the error of profiles", "mean": "RMS length of the error of depth-averaged currents"}


def print_dives(result: DivesResult, console: Console) -> None:
    """Print what a person reads: errors by dive and method, calibration, surfacings."""
    for kind, title in _TITLES.items():
        overall = result.rmse(kind)
        if overall:
            console.print(_table(result, kind, title, overall))
    covered = result.coverages()
    if np.isfinite(result.nis_per_dof):
        next_dive, held = (", ".join(f"{share:.0%}: {value:.0%}" for share, value in covered[name].items()) for name in covered)
        _say(console, f"NIS per degree of freedom of next dives {result.nis_per_dof:.2f}; of their bins in intervals of {next_dive}")
        _say(console, f"Of bins withheld from a dive, given the others, in intervals of {held}")
    surfacings = [dive.surfacing for dive in result.dives if dive.surfacing is not None]
    if surfacings:
        inside = sum(found.inside for found in surfacings)
        off = np.median([found.error_m for found in surfacings])
        _say(console, f"Surfacings: {inside} of {len(surfacings)} in the predicted ellipse of 90 %; median distance {off:.0f} m")
    if result.fitted:
        words = ", ".join(f"{name} {value:g}" for name, value in asdict(result.dives[-1].settings).items())
        _say(console, f"Fitted to the dives before the last: {words}")


def _table(result: DivesResult, kind: str, title: str, overall: Mapping[str, float]) -> Table:
    table = Table("dive", *(method.replace("_", " ") for method in overall), title=f"{title}, cm/s", title_justify="left")
    for dive in result.dives[1:]:
        table.add_row(str(dive.number), *(_cm(_rmse(dive, kind, method)) for method in overall))
    table.add_row("all", *(_cm(total) for total in overall.values()))
    return table


def _rmse(dive: DivePrediction, kind: str, method: str) -> float:
    errors: Mapping[str, Any] = getattr(dive, kind)
    return rms_length([errors[method]] if method in errors else [])


def _cm(value: float) -> str:
    return "" if np.isnan(value) else f"{100.0 * value:.1f}"


def _say(console: Console, sentence: str) -> None:
    console.print(sentence, soft_wrap=True)


def to_json(result: DivesResult) -> dict[str, Any]:
    """Return the result's figures for JSON; undefined ones are null, as is a scale that is infinite."""
    return {
        "rmse": {kind: {method: _number(value) for method, value in result.rmse(kind).items()} for kind in _TITLES},
        "nis_per_dof": _number(result.nis_per_dof),
        "coverage": {
            name: {f"{share:g}": _number(value) for share, value in shares.items()} for name, shares in result.coverages().items()
        },
        "dives": [_dive_json(dive) for dive in result.dives],
        "ensemble": result.ensemble,
        "fitted": result.fitted,
        "oscillators": list(result.oscillators),
        "versions": {"replay_kit": __version__, "numpy": np.__version__},
    }


def _dive_json(dive: DivePrediction) -> dict[str, Any]:
    return {
        "dive": dive.number,
        "bins": len(dive.std),
        **{f"rmse_{kind}": {method: _number(_rmse(dive, kind, method)) for method in getattr(dive, kind)} for kind in _TITLES},
        "nis_per_dof": _number(dive.nis / dive.dof if dive.dof else float("nan")),
        "surfacing": None if dive.surfacing is None else _surfacing_json(dive.surfacing),
        "settings": {name: _number(value) for name, value in asdict(dive.settings).items()},
    }


def _surfacing_json(found: Surfacing) -> dict[str, Any]:
    return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(found).items()}


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
