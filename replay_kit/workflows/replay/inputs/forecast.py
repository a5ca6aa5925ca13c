"""Forecast of a run, read from files as the settings state."""

import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Literal

import numpy as np

from replay_kit.config.run import RunConfig
from replay_kit.core.errors import Caveat, ConfigError, ForecastError
from replay_kit.core.files.paths import Paths
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.grid import Ensemble
from replay_kit.core.region import Region
from replay_kit.estimator import Estimator, ReducedBasisEstimator
from replay_kit.estimator import build as build_reduced
from replay_kit.estimator.baselines import build_named
from replay_kit.estimator.basis.slices import correlation_length
from replay_kit.estimator.windows.filter import WindowedEstimator
from replay_kit.forecast import read_ensemble, read_series
from replay_kit.forecast.grids.horizontal import in_frame
from replay_kit.forecast.members.collection import Collection
from replay_kit.forecast.members.rules import WARNING
from replay_kit.workflows.replay.inputs.region import FoundRegion, estimator_asked

#: Name of the project's own estimator; the others are baselines.
OWN = "reduced_basis"
# A current is told from E members by Student's t with E - 1 degrees of freedom, whose variance exists from three on: of fewer
# members the spread states no error.
_LEAST_MEMBERS = 4
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class Forecasts:
    """Part of a forecast used by a run.

    Attributes:
        series: Forecast at the used times, in order.
        evolves: Whether the estimate follows the forecast's times, or has further unknowns that change.
        near_ns: Time of the logs' first message [ns, UTC]; None without one.
        region: Part of the forecast found from the logs; None if all of it, or the part in the settings, was read.
        read: Reads another window of the forecast, in the local frame of the first; None for a single window.
    """

    series: tuple[Ensemble, ...]
    evolves: bool
    near_ns: int | None = None
    region: FoundRegion | None = None
    read: Callable[[Region], Ensemble] | None = None

    @property
    def ensemble(self) -> Ensemble:
        """Forecast of the series nearest to the log's beginning."""
        return self.nearest(self.near_ns)

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on how the file was read."""
        return self.series[0].notes

    @property
    def box(self) -> Region | None:
        """West, south, east, north [degrees] of the part found from the logs; None without one."""
        return None if self.region is None else self.region.region

    def nearest(self, time_ns: int | None) -> Ensemble:
        """Return the forecast nearest to a time [ns, UTC]; the first if None."""
        if time_ns is None:
            return self.series[0]
        return min(self.series, key=lambda forecast: abs((forecast.time_ns or 0) - time_ns))


def read_forecasts(
    path: Paths,
    config: RunConfig,
    near_ns: int | None,
    place_at: tuple[float, float] | None,
    region: FoundRegion | None = None,
    found: Collection | None = None,
) -> Forecasts:
    """Return the forecast at the times of the settings.

    The estimate follows the times of a forecast of several, unless one is chosen or ``time.scale`` is static.

    Args:
        path: Files of the ensemble.
        config: The run's settings.
        near_ns: Time of the logs' first message [ns, UTC].
        place_at: (longitude, latitude) of the moved ensemble's centre.
        region: Part of the forecast, if found from the logs.
        found: The files, if open.

    Raises:
        ForecastError: The ensemble cannot be used, or the region is narrower than a correlation length.
        ConfigError: A setting needs an estimator that changes, or fits the spread.
    """
    is_default, asked = estimator_asked(config)
    if (asked or config.time.window not in ("auto", 0.0)) and not is_default:
        name = config.estimator.name
        what = name if name != OWN else f"preset {config.estimator.preset}"
        raise ConfigError(
            f"{what} is static and takes each profile alone: it has no time.scale, oscillators, biases or window; leave them out, or the "
            "estimator's name"
        )
    part = (
        config.forecast
        if region is None
        else config.forecast.model_copy(update={"region": region.region})
    )
    if is_default and (asked or config.time.scale == "auto"):
        series = read_series(found or path, part, near_ns=near_ns, place_at=place_at)
        evolves = len(series) > 1 or bool(config.time.oscillators or config.time.biases)
    else:
        ensemble = read_ensemble(found or path, part, near_ns=near_ns, place_at=place_at)
        series, evolves = (ensemble,), False
    if part.region is not None:
        length, grid = correlation_length(series[0]), series[0].grid
        widths = [float(np.ptp(axis)) for axis in (grid.east, grid.north)]
        if min(widths) < length:
            # only a mean could be estimated
            raise ForecastError(
                f"{series[0].source}: the region is {widths[0] / 1e3:.1f} x {widths[1] / 1e3:.1f} km, and the forecast's correlation "
                f"length {length / 1e3:.1f} km: widen --region"
            )
    of_region = () if region is None else (region.note,)
    of_spread = _spread_notes(config, evolves, series[0])
    notes = (*of_region, *series[0].notes, *of_spread)
    series = (replace(series[0], notes=notes), *series[1:])
    for text in series[0].notes:
        # matters before a long run
        if text.startswith(WARNING):
            _LOG.warning(text.removeprefix(WARNING))
    first = Forecasts(series, evolves, near_ns).ensemble

    def read(window: Region) -> Ensemble:
        """Return a window of the forecast in the frame of the first."""
        # terrain-following levels would be those of each window's own deepest column
        levels = tuple(float(level) for level in first.grid.levels)
        asked = part.model_copy(update={"levels": levels, "region": window})
        return in_frame(read_ensemble(path, asked, near_ns=near_ns), first.grid.projection)

    follows = read if region is not None and region.follows else None
    return Forecasts(series, evolves, near_ns, region, follows)


def _spread_notes(config: RunConfig, evolves: bool, ensemble: Ensemble) -> Iterator[str]:
    """Yield a note on made members whose spread is not fitted, and a warning on too few members to state errors from their spread.

    Raises:
        ConfigError: The estimator does not support the setting of the spread.
    """
    settings, is_own = config.estimator, config.estimator.name == OWN
    preset, spread = settings.preset, settings.spread
    is_default, made_from = is_own and preset == "default", ensemble.made_from
    if evolves or not is_default:
        what = (
            "an estimate through time"
            if evolves
            else f"the preset {preset}"
            if is_own
            else f"the estimator {settings.name}"
        )
        if spread == "fit" or (isinstance(spread, float) and not is_own):
            expected = "as_given or a number" if is_own else "as_given"
            instead = "leave it out" + (', or set time.scale = "static"' if evolves else "")
            raise ConfigError(
                f"estimator.spread: expected {expected} with {what}, got {spread}; {instead}"
            )
        if made_from and spread is None:
            yield f"the spread of members made of {made_from} is used as their error: {what} does not fit it"
    stated = is_default and settings.representation_error_std is not None
    if is_own and ensemble.n_members < _LEAST_MEMBERS and not stated:
        yield Caveat(
            f"{WARNING}{ensemble.n_members} members are too few to state errors, expected {_LEAST_MEMBERS} or more; "
            "set estimator.representation_error_std [m/s], such as to the RMS innovation that this replay prints"
        )


def build(forecasts: Forecasts, config: RunConfig, vehicles: int = 1) -> Estimator[Any]:
    """Return the estimator of a run.

    Args:
        forecasts: Forecast to build from.
        config: The run's settings.
        vehicles: Largest number of vehicles that windows follow.

    Raises:
        ConfigError: The estimator's name is unknown.
    """
    made: Estimator[Any]
    if forecasts.region is not None and forecasts.read is not None:
        made = _windowed(forecasts, forecasts.region, forecasts.read, config, vehicles)
    elif config.estimator.name != OWN:
        made = build_named(forecasts.ensemble, config.estimator)
    else:
        series = forecasts.series if forecasts.evolves else (forecasts.ensemble,)
        made = build_reduced(series, config.estimator, config.gating, config.time)
    return with_window(made, config.time.window)


def with_window(estimator: Estimator[Any], window: float | Literal["auto"]) -> Estimator[Any]:
    """Return an estimator that combines profiles within a time [s]; auto keeps its own value, 0 combines none."""
    grouping = estimator.grouping
    if grouping is None or window == "auto":
        return estimator
    # Any: those that have a grouping are dataclasses
    grouped: Any = estimator
    changed: Estimator[Any] = replace(
        grouped, grouping=grouping.by_hand(window) if window > 0.0 else None
    )
    return changed


def _windowed(
    forecasts: Forecasts,
    found: FoundRegion,
    read: Callable[[Region], Ensemble],
    config: RunConfig,
    vehicles: int,
) -> WindowedEstimator:
    """Return the estimator of windows that follow vehicles; keeps one window more than vehicles."""

    @lru_cache(maxsize=vehicles + 1)
    def estimator_of(region: Region) -> ReducedBasisEstimator:
        ensemble = forecasts.ensemble if region == found.region else read(region)
        return build_reduced([ensemble], config.estimator, config.gating, config.time)

    grouping = estimator_of(found.region).grouping
    return WindowedEstimator(found.region, found.margin, found.bounds, estimator_of, grouping)


def flow_at(estimator: Estimator[Any], state: Any, time_ns: int) -> FlowEstimate:
    """Return the current estimate of a state at or after its last observation [ns, UTC]; a static one is unchanged."""
    return estimator.flow(estimator.predict(state, time_ns))
