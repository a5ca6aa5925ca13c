"""An opened result with the values that reports, figures and exports share, each taken out of it when first asked for."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.as_flown import AsFlown
from replay_kit.core.errors import ConfigError, ReplayKitError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.grid import Projection, Seabed
from replay_kit.results.innovations import Measured
from replay_kit.results.outcome.outcome import Outcome
from replay_kit.results.result import ResultFile
from replay_kit.results.views.along_track import (
    BinsAlongTrack,
    MeanCurrents,
    bins_along_track,
    estimate_along_track,
    mean_currents,
)
from replay_kit.results.views.history import EstimateHistory, Series, mean_to_depth, series_of
from replay_kit.results.views.slices import CurrentSlices, on_grid, published_slices, slices_of
from replay_kit.results.views.track import LastPlan, Track, last_plan, published_seabed, track_of

#: Profiles shown along the track; more are thinned.
PROFILES_SHOWN = 600


@dataclass(frozen=True, eq=False)
class Contents:
    """An opened result, and what was found when it was opened.

    Attributes:
        result: The result.
        notes: What the reader of the report should know of how it was opened, such as what of the file was lost.
        exit_code: Of the command that shows it: 4 where something was lost, else 0.
    """

    result: ResultFile
    notes: tuple[str, ...] = ()
    exit_code: int = 0

    @cached_property
    def each(self) -> Mapping[str, "Contents"]:
        """The contents of each vehicle by its name, where several share the estimate; of one alone these, under an empty name."""
        vehicles: Mapping[str, ResultFile] = getattr(self.result, "vehicles", {})
        found = {name: Contents(one) for name, one in vehicles.items()}
        return found or {"": self}

    def of(self, vehicle: str | None) -> "Contents":
        """Return the contents of a vehicle, by its name; None for the only one.

        Raises:
            ConfigError: The result is not of this vehicle, or of several where none is named.
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
        """Records of how the result was made, by name."""
        return self.result.reader.metadata

    @property
    def outcome(self) -> Outcome:
        """The run's outcome."""
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
        """The last estimate; None when the result has none that can be read."""
        return self._read_estimate[0]

    @property
    def without_estimate(self) -> str:
        """Why there is no estimate; empty when there is one."""
        return self._read_estimate[1]

    @property
    def measured(self) -> Measured:
        """Its measurements as far as figures need them."""
        return self.result.measured

    @cached_property
    def track(self) -> Track:
        """Where the vehicle was."""
        return track_of(self.result.fixes, self.projection)

    @cached_property
    def slices(self) -> CurrentSlices | None:
        """The published current; that of the last estimate at its levels when none was published, None without that."""
        estimate = self.estimate
        grid = None if estimate is None else estimate.grid
        published = published_slices(self.result.reader, grid)
        if estimate is None:
            return published
        return (
            slices_of(estimate, estimate.levels)
            if published is None
            else on_grid(published, estimate.grid)
        )

    @cached_property
    def history(self) -> EstimateHistory:
        """The estimate after each measurement."""
        return EstimateHistory(self.result.reader, self.estimate)

    @cached_property
    def flown(self) -> AsFlown | None:
        """How the vehicle flew its dives; None where the result does not say it."""
        return AsFlown.in_metadata(self.metadata)

    @cached_property
    def dive_depth(self) -> float:
        """Depth of the vehicle's dives [m]: of the plan's, as flown, of the track, or of the deepest published current."""
        plan, flown = self.last_plan, self.flown
        if plan is not None and plan.legs:
            return max(float(leg["depth_m"]) for leg in plan.legs)
        if flown is not None and flown.depth > 1.0:
            return float(flown.depth)
        deepest = float(np.nanmax(self.track.depth, initial=0.0))
        if deepest > 1.0:
            return float(np.ceil(deepest))
        return 10.0 if self.slices is None else float(max(self.slices.depths[-1], 1.0))

    @cached_property
    def dive_mean(self) -> Array | None:
        """The mean current down to ``dive_depth``, as ``mean_to_depth``; None without a published current."""
        if self.slices is None:
            return None
        return mean_to_depth(self.slices, self.history, self.dive_depth)

    def series(self, place: tuple[float, float, float]) -> Series | None:
        """Return the current at a longitude, latitude [degrees] and depth [m] through time; None without a current."""
        if self.slices is None:
            return None
        return series_of(self.slices, self.projection, self.history, place)

    @cached_property
    def bins(self) -> BinsAlongTrack:
        """Bins used along the track."""
        return bins_along_track(
            self.measured, self.track, self.history, self.estimate, PROFILES_SHOWN
        )

    @cached_property
    def section(self) -> BinsAlongTrack:
        """What a section shows: the bins used, or without any the estimate along the track, if there are both."""
        if self.bins.time_ns.size or self.estimate is None or not self.track.time_ns.size:
            return self.bins
        return estimate_along_track(self.track, self.history, self.estimate)

    @cached_property
    def mean_currents(self) -> MeanCurrents:
        """Mean currents of the dives."""
        return mean_currents(self.measured)

    @cached_property
    def last_plan(self) -> LastPlan | None:
        """The last plan; None without plans, and of several vehicles, each of which has its own."""
        if "" not in self.each:
            return None
        return last_plan(self.result, self.projection)

    @cached_property
    def seabed(self) -> Seabed | None:
        """The bottom around the region; None without a bathymetry."""
        return published_seabed(self.result.reader)

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """Times of the first and the last fix or measurement [ns, UTC]; None without any."""
        sums = self.measured.sums
        ends = self.track.time_ns[[0, -1]].tolist() if self.track.time_ns.size else []
        if len(sums):
            ends += [sums["first"].min().value, sums["last"].max().value]
        return (min(ends), max(ends)) if ends else None
