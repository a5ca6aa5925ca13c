"""Result MCAP for notebooks: the estimate, and tables of all else."""

from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.points import Velocities, best_velocity_at
from replay_kit.core.geodesy import to_geographic
from replay_kit.core.words.text import time_text
from replay_kit.results.innovations import (
    Columns,
    Measured,
    Tables,
    blocks_in,
    dives_of,
    joined_blocks,
    measured_of,
    table_of,
    tables_of,
)
from replay_kit.results.mcap.schemas import MESSAGES, TIME, decode, numbers
from replay_kit.results.mcap.topics import ESTIMATE_NAME, OpenResult
from replay_kit.results.outcome.outcome import Outcome
from replay_kit.results.reader import ResultReader
from replay_kit.results.slices import surface_table

if TYPE_CHECKING:
    import pandas as pd


_LEVELS = {1: "debug", 2: "info", 3: "warning", 4: "error"}


@dataclass(frozen=True, eq=False, repr=False)
class ResultFile:
    """Result of a replay. Tables are pandas tables with UTC times, read on demand.

    Attributes:
        path: Result MCAP.
        made: Outcome of the replay that has just made it, with wall times and score; None for an opened result.
        vehicle: Name of one of several vehicles; empty for the whole.
        opened: The file, if open.
    """

    path: Path
    made: Outcome | None = None
    vehicle: str = ""
    opened: OpenResult | None = None

    def __repr__(self) -> str:
        """Return the contents of the result as text."""
        held = f"estimate: {self.outcome.verdict}" if self.has_estimate else "no estimate"
        ends, topics = self.reader.summary.statistics, self.reader.topics
        assert ends is not None
        tables = {
            "fixes": "/vehicle/fix",
            "plans": "/plan/controls",
            "surfacings": "/plan/outcome",
            "events": "/log",
        }
        rows = ", ".join(f"{name} ({topics.get(topic, 0)})" for name, topic in tables.items())
        times = " to ".join(
            time_text(end) for end in (ends.message_start_time, ends.message_end_time)
        )
        return f"Result {self.reader.name}, {times}\n  {held}; tables {rows}, observations, innovations, dives, plan_tracks"

    @cached_property
    def reader(self) -> ResultReader:
        """Reader of its records and messages."""
        return ResultReader(self.path, self.vehicle, self.opened)

    @cached_property
    def outcome(self) -> Outcome:
        """Outcome of the run: counts, misfit, verdict, plan, surfacings, findings, losses."""
        return self.made or self.reader.outcome or Outcome(complete=False)

    @property
    def has_estimate(self) -> bool:
        """Whether it holds an estimate."""
        found = self.reader.summary.attachment_indexes
        return any(one.name == ESTIMATE_NAME for one in found)

    @cached_property
    def estimate(self) -> FlowEstimate:
        """Last estimate.

        Raises:
            ForecastError: The result has no estimate.
        """
        return self.reader.estimate()

    @cached_property
    def estimates(self) -> tuple[FlowEstimate, ...]:
        """Last estimate of each window that followed the vehicle, in order; else ``estimate`` alone.

        Raises:
            ForecastError: The result has no estimate.
        """
        return self.reader.estimates()

    def velocity_at(
        self, longitude: ArrayLike, latitude: ArrayLike, depth: ArrayLike, time: Any = None
    ) -> Velocities:
        """Return velocity and standard error at points, each from the best window; see ``FlowEstimate.velocity_at``.

        Raises:
            ForecastError: The result has no estimate.
        """
        return best_velocity_at(self.estimates, longitude, latitude, depth, time)

    @cached_property
    def fixes(self) -> "pd.DataFrame":
        """Positions: longitude and latitude [degrees], depth [m] (NaN if unknown), whether dead-reckoned."""
        # rows of Python values of a million positions do not fit into memory
        rows = array("d")
        times = array("q")
        for time_ns, fix in self.reader.decoded("/vehicle/fix"):
            about = {pair.key: pair.value for pair in fix.metadata}
            times.append(time_ns)
            depth, reckoned = about.get("depth", "nan"), about.get("dead_reckoned") == "1"
            rows.extend((fix.longitude, fix.latitude, float(depth), reckoned))
        longitude, latitude, depths, dead = np.array(rows).reshape(-1, 4).T
        return table_of(
            {
                "time": np.array(times, np.int64).view("datetime64[ns]"),
                "longitude": longitude,
                "latitude": latitude,
                "depth": depths,
                "dead_reckoned": dead > 0.0,
            }
        )

    @property
    def observations(self) -> "pd.DataFrame":
        """Measurements and their use, one row each: the single values of ``replay_kit.Innovations``.

        ``rms_innovation``, ``rms_residual`` and ``rms_prior_innovation`` [m/s] are over the components of used bins. For a mean current
        ``predicted`` and ``estimated`` are the estimate's mean along the path before and after the update.
        """
        return self._tables[0]

    @property
    def innovations(self) -> "pd.DataFrame":
        """Bins of the measurements, one row each, from ``replay_kit.Innovations``; ``observation`` is the row in ``observations``.

        Unknown values are NaN.
        """
        return self._tables[1]

    @cached_property
    def _tables(self) -> Tables:
        return tables_of(joined_blocks(self.blocks()))

    @cached_property
    def measured(self) -> Measured:
        """Measurements thinned for figures, with sums over all."""
        return measured_of(self.blocks())

    def blocks(self) -> Iterator[Columns]:
        """Yield the columns of ``/flow/innovation`` by block, see ``columns_of``."""
        return blocks_in(self.reader)

    @cached_property
    def dives(self) -> "pd.DataFrame":
        """Dives: start, end, number of profiles, bins and DACs used, RMS values [m/s] as in ``observations``, NIS per value.

        Start and end are the times of the first and the last measurement; a mean current starts at the fix before it.
        """
        return dives_of(self.measured.sums, self.fixes)

    @cached_property
    def plans(self) -> "pd.DataFrame":
        """Plans, one row each: the single values of ``replay_kit.Plan``."""
        return self._single_values("/plan/controls", "Plan")

    @cached_property
    def plan_tracks(self) -> "pd.DataFrame":
        """Predicted tracks of the plans: time, longitude and latitude [degrees], depth [m]; ``plan`` is the row in ``plans``.

        ``bottom`` is the seabed depth under the track [m]; NaN without a bathymetry.
        """
        projection, rows = self.reader.projection, list[tuple[Any, ...]]()
        for number, plan in enumerate(self._decoded("/plan/controls", "Plan")):
            start = plan.timestamp.ToNanoseconds()
            seconds, east, north, depth, bottom = (
                numbers("Plan", plan, f"track_{name}")
                for name in ("time", "east", "north", "depth", "bottom")
            )
            times = start + np.rint(1e9 * seconds).astype(np.int64)
            places, unknown = to_geographic(projection, east, north), [np.nan] * len(times)
            known = bottom if bottom.size else unknown
            rows += zip(times, *places, depth, [number] * len(times), known, strict=True)
        return _table(rows, "time longitude latitude depth plan bottom")

    @cached_property
    def surface(self) -> "pd.DataFrame":
        """Surface currents from radar vectors and the estimate, one row per cell with a current and time.

        Longitude and latitude [degrees], depth [m], u, v towards true east and north, and their standard errors [m/s].
        """
        return surface_table(self.reader.decoded("/flow/surface"), self.reader.projection)

    @cached_property
    def surfacings(self) -> "pd.DataFrame":
        """Surfacings predicted by plans and the actual ones, one row each: the values of ``replay_kit.PlanOutcome``."""
        return self._single_values("/plan/outcome", "PlanOutcome")

    @cached_property
    def events(self) -> "pd.DataFrame":
        """Events: level and message."""
        return _table(
            [
                (time_ns, _LEVELS[event.level], event.message)
                for time_ns, event in self.reader.decoded("/log")
            ],
            "time level message",
        )

    def _decoded(self, topic: str, name: str) -> Iterator[Any]:
        return (decode(name, data) for _, data in self.reader.messages(topic))

    def _single_values(self, topic: str, name: str) -> "pd.DataFrame":
        """Return the single values of the messages of a topic, one column each, also for parts of nested messages.

        Missing parts are NaN.
        """
        messages, columns = [*self._decoded(topic, name)], dict[str, Any]()
        for field in MESSAGES[name]:
            held = [getattr(one, field.name) for one in messages]
            if field.type == TIME:
                times = np.array([one.ToNanoseconds() for one in held], np.int64)
                columns[field.name] = times.view("datetime64[ns]")
            elif field.type.startswith(".") and not field.repeated:
                for part in MESSAGES[field.type.rpartition(".")[2]]:
                    columns[f"{field.name}_{part.name}"] = [
                        getattr(value, part.name) if one.HasField(field.name) else np.nan
                        for one, value in zip(messages, held, strict=True)
                    ]
            elif not field.repeated:
                columns[field.name] = held
        return table_of(columns)


def _table(rows: list[Any], columns: str) -> "pd.DataFrame":
    """Return rows as a table with index ``time``."""
    import pandas as pd

    table = pd.DataFrame(rows, columns=columns.split())
    return table.assign(time=pd.to_datetime(table["time"])).set_index("time")
