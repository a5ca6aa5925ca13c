"""Opened result with the values shared by reports, figures and exports, each read on demand."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd

from replay_kit.core.arrays import Array
from replay_kit.core.as_flown import AsFlown
from replay_kit.core.errors import ConfigError, ReplayKitError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.grid import Projection, Seabed
from replay_kit.core.plan import Plan
from replay_kit.results.geojson import last_plan
from replay_kit.results.innovations import Measured
from replay_kit.results.outcome.outcome import Outcome
from replay_kit.results.result import ResultFile
from replay_kit.results.slices import grid_cells
from replay_kit.results.views.along_track import (
    BinsAlongTrack,
    Track,
    bins_along_track,
    estimate_along_track,
    mean_currents,
    track_of,
)
from replay_kit.results.views.current import (
    At,
    CurrentSlices,
    EstimateHistory,
    mean_to_depth,
    on_grid,
    published_slices,
    series_of,
    slices_of,
)

#: Profiles shown along the track; more are thinned.
PROFILES_SHOWN = 600


@dataclass(frozen=True, eq=False)
class Contents:
    """Opened result with notes on its opening.

    Attributes:
        result: The result.
        notes: Notes on the opening for the report, such as lost parts of the file.
        exit_code: Exit code of the command that shows it: 4 after a loss, else 0.
    """

    result: ResultFile
    notes: tuple[str, ...] = ()
    exit_code: int = 0

    @cached_property
    def each(self) -> Mapping[str, "Contents"]:
        """Contents of each vehicle by name, if several share the estimate; else these under an empty name."""
        vehicles: Mapping[str, ResultFile] = getattr(self.result, "vehicles", {})
        found = {name: Contents(one) for name, one in vehicles.items()}
        return found or {"": self}

    def for_vehicle(self, vehicle: str | None) -> "Contents":
        """Return the contents of a vehicle by name; None for a single one.

        Raises:
            ConfigError: The result lacks this vehicle, or has several and none is named.
        """
        if vehicle is None and "" in self.each:
            return self
        if not vehicle or vehicle not in self.each:
            known = ", ".join(filter(None, self.each)) or "none, as it is of one vehicle"
            raise ConfigError(
                f"--vehicle: expected a vehicle of {self.result.reader.name} ({known}), got {vehicle or 'none'}"
            )
        return self.each[vehicle]

    @property
    def metadata(self) -> Mapping[str, Mapping[str, str]]:
        """Metadata records of the run by name."""
        return self.result.reader.metadata

    @property
    def outcome(self) -> Outcome:
        """Outcome of the run."""
        return self.result.outcome

    @property
    def projection(self) -> Projection:
        """The local frame."""
        return self.result.reader.projection

    @cached_property
    def _read_estimate(self) -> tuple[FlowEstimate | None, str]:
        try:
            return self.result.estimate, ""
        except ReplayKitError as error:
            # without the folder: the same result gives the same page wherever it lies
            return None, str(error).replace(str(self.result.path), self.result.reader.name)

    @property
    def estimate(self) -> FlowEstimate | None:
        """Last estimate; None if there is none that can be read."""
        return self._read_estimate[0]

    @property
    def without_estimate(self) -> str:
        """Reason for a missing estimate; else empty."""
        return self._read_estimate[1]

    @property
    def measured(self) -> Measured:
        """Measurements thinned for figures."""
        return self.result.measured

    @cached_property
    def track(self) -> Track:
        """Track of the vehicle."""
        return track_of(self.result.fixes, self.projection)

    @cached_property
    def slices(self) -> CurrentSlices | None:
        """Published current; if none was published, the last estimate at its levels; None without one."""
        estimate = self.estimate
        grid = None if estimate is None else estimate.grid
        published = published_slices(self.result.reader, grid)
        if estimate is None:
            return published
        if published is None:
            return slices_of(estimate, estimate.levels)
        return on_grid(published, estimate.grid)

    @cached_property
    def history(self) -> EstimateHistory:
        """Estimate after each measurement."""
        return EstimateHistory(self.result.reader, self.estimate)

    @cached_property
    def flown(self) -> AsFlown | None:
        """Flight parameters of the dives; None if not in the result."""
        return AsFlown.in_metadata(self.metadata)

    @cached_property
    def dive_depth(self) -> float:
        """Depth of the vehicle's dives [m]: planned, as flown, of the track, or of the deepest published current, for radars the first."""
        plan, flown = self.last_plan, self.flown
        if plan is not None and plan.legs:
            return max(float(leg["depth_m"]) for leg in plan.legs)
        if flown is not None and flown.depth > 1.0:
            return float(flown.depth)
        deepest = float(np.nanmax(self.track.depth, initial=0.0))
        if deepest > 1.0:
            return float(np.ceil(deepest))
        if self.slices is None:
            return 10.0
        # radars and drifters know nothing of the depth below
        below = self.bins.profiles or len(self.mean_currents) or not self.measured.count
        return float(max(self.slices.depths[-1 if below else 0], 1.0))

    @cached_property
    def dive_mean(self) -> Array | None:
        """Mean current down to ``dive_depth``, see ``mean_to_depth``; None without a published current."""
        if self.slices is None:
            return None
        return mean_to_depth(self.slices, self.history, self.dive_depth)

    def series(self, place: At) -> pd.DataFrame | None:
        """Return the current at a position through time, see ``series_of``; None without a current."""
        if self.slices is None:
            return None
        return series_of(self.slices, self.projection, self.history, place)

    @cached_property
    def bins(self) -> BinsAlongTrack:
        """Used bins along the track."""
        return bins_along_track(self.measured, self.track, self.history, PROFILES_SHOWN)

    @cached_property
    def section(self) -> BinsAlongTrack:
        """Bins for a section: used ones or, without any, the estimate along the track if both exist."""
        if self.bins.time_ns.size or self.estimate is None or not self.track.time_ns.size:
            return self.bins
        return estimate_along_track(self.track, self.history, self.estimate)

    @cached_property
    def mean_currents(self) -> pd.DataFrame:
        """Mean currents of the dives, see ``along_track.mean_currents``."""
        return mean_currents(self.measured)

    @cached_property
    def last_plan(self) -> Plan | None:
        """Last plan; None without plans and for several vehicles."""
        if "" not in self.each:
            return None
        return last_plan(self.result.reader)

    @cached_property
    def seabed(self) -> Seabed | None:
        """Seabed around the region; None without a bathymetry."""
        for _, value in self.result.reader.decoded("/plan/seabed"):
            east, north, fields = grid_cells(value)
            return Seabed(east, north, fields["depth"])
        return None

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """Times of the first and the last fix or measurement [ns, UTC]; None without any."""
        sums = self.measured.sums
        ends = self.track.time_ns[[0, -1]].tolist() if self.track.time_ns.size else []
        if len(sums):
            ends += [sums["first"].min().value, sums["last"].max().value]
        return (min(ends), max(ends)) if ends else None
