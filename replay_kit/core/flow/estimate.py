"""The current estimate: what a planner or an analyst holds."""

# keeps the signatures in help() short: the names of types, not what they stand for
from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from replay_kit.core.flow.field import FlowField
from replay_kit.core.paths import as_path
from replay_kit.core.quantities import to_time_ns
from replay_kit.core.text import time_text

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

    from replay_kit.core.flow.points import Velocities


@dataclass(frozen=True, eq=False, repr=False)
class FlowEstimate(FlowField):
    """A horizontally divergence-free flow in a box, with its uncertainty when known, that can be exported and saved.

    Attributes and evaluation in the local frame are those of ``FlowField``. xarray is imported on export only, as most of a run does
    without it.
    """

    def __repr__(self) -> str:
        """Return its time, region and size."""
        holds = "no model of time" if self.later is None else "at(time) gives it for another time"
        uncertainty = f"{self.n_modes} modes a level" if self.n_modes else "no uncertainty"
        return f"FlowEstimate for {time_text(self.time_ns)} ({holds}), {uncertainty}\n  {self.grid}"

    def velocity_at(
        self, longitude: ArrayLike, latitude: ArrayLike, depth: ArrayLike, time: Any = None
    ) -> Velocities:
        """Return velocity and standard error towards true east and true north at points; NaN where nothing is known.

        Args:
            longitude: [degrees east], any shape; the four broadcast together.
            latitude: [degrees north].
            depth: [m], positive down.
            time: ISO 8601 text, datetime64 or integer nanoseconds (UTC), as in ``at``; None for the estimate's own time.

        Raises:
            EstimatorError: The flow has no model of time, or a time is before its last observation, or a latitude is none.
            ConfigError: A time is none.
        """
        from replay_kit.core.flow.points import velocity_at

        return velocity_at(self, longitude, latitude, depth, time)

    def along(self, track: Any) -> Velocities:
        """Return velocity and standard error along a track, such as ``result.fixes``.

        Args:
            track: pandas table, xarray dataset or mapping with ``longitude``, ``latitude``, ``depth`` and, if it has, ``time``, of one
                shape. Where the track is older than the last observation, an estimate that changes with time is that of the latter;
                a flow without a model of time is as it is: see ``Velocities.estimate_time``.

        Raises:
            EstimatorError: A column is missing, or a latitude is none.
            ConfigError: A time is none.
        """
        from replay_kit.core.flow.points import velocity_along

        return velocity_along(self, track)

    def to_xarray(
        self,
        longitude: ArrayLike | None = None,
        latitude: ArrayLike | None = None,
        depth: ArrayLike | None = None,
        time: Any = None,
    ) -> xr.Dataset:
        """Return velocity and standard error on a grid as a CF dataset, NaN where dry, for ``.sel`` and plots.

        On axes given, and on a forecast's grid of longitudes and latitudes, the coordinates are one-dimensional. A curvilinear grid has
        two-dimensional longitude and latitude on ``y`` and ``x``, which ``.sel`` does not take: give the axes.

        Args:
            longitude: shape (I,) [degrees east]; None, with the next two, for the flow's own grid and levels.
            latitude: shape (J,) [degrees north].
            depth: shape (D,) [m], positive down.
            time: As in ``at``, one or a list, which makes ``time`` a dimension; None for the estimate's own.

        Raises:
            EstimatorError: Only some of the three axes are given, or one is not one-dimensional, or the flow has no model of time.
        """
        from replay_kit.core.flow.netcdf import to_dataset

        if time is None:
            return to_dataset(self, longitude, latitude, depth)
        time_ns = to_time_ns(time)
        datasets = [
            to_dataset(self.at(each), longitude, latitude, depth)
            for each in time_ns.ravel().tolist()
        ]
        if time_ns.ndim == 0:
            return datasets[0]
        import xarray as xr

        from replay_kit.core.flow.cf import described, encoded
        from replay_kit.core.flow.lossless import history

        many = xr.concat(datasets, "time", combine_attrs="drop_conflicts")
        made_by = history("to_dataset", self)
        return encoded(described(many, many.attrs["title"], made_by, self.about))

    def to_pandas(self, **axes: ArrayLike) -> pd.DataFrame:
        """Return ``to_xarray(**axes)`` as a table with a row a point and time where the flow is known."""
        return self.to_xarray(**axes).to_dataframe().dropna(subset=["u"]).reset_index()

    def save(self, path: str | Path) -> None:
        """Write the flow to NetCDF without loss; ``replay_kit.open_estimate`` reads it back."""
        from replay_kit.core.flow.lossless import save

        save(self, as_path(path, "estimate"))
