"""A result MCAP as a notebook wants it: the estimate, and tables of all else."""

import struct
from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import repeat
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from mcap.exceptions import McapError
from mcap.reader import McapReader, make_reader
from mcap_protobuf.decoder import DecoderFactory

from replay_kit.core.errors import LogError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import to_geographic
from replay_kit.core.grid import Projection
from replay_kit.core.paths import as_path
from replay_kit.core.text import time_text
from replay_kit.results.mcap_reader import read_estimate
from replay_kit.results.mcap_writer import ESTIMATE_NAME
from replay_kit.results.schemas import MESSAGES, TIME, decode
from replay_kit.results.summary import ReplaySummary

if TYPE_CHECKING:
    import pandas as pd


_OWN = ".replay_kit."
_LEVELS = {1: "debug", 2: "info", 3: "warning", 4: "error"}
_RMS = ("innovation", "residual", "prior_innovation")


@dataclass(frozen=True, eq=False, repr=False)
class ResultFile:
    """What a replay found. Tables are pandas', with UTC times; each is read when first asked for.

    Attributes:
        path: The result MCAP.
        summary: Of the replay that made it; None for a result that was opened.
    """

    path: Path
    summary: ReplaySummary | None = None

    def __repr__(self) -> str:
        """Return what the result holds."""
        with self.path.open("rb") as file:
            found = make_reader(file).get_summary()
        assert found is not None
        assert found.statistics is not None
        counts, ends = found.statistics.channel_message_counts, found.statistics
        by_topic = {channel.topic: counts.get(key, 0) for key, channel in found.channels.items()}
        held = "estimate" if any(index.name == ESTIMATE_NAME for index in found.attachment_indexes) else "no estimate"
        tables = {"fixes": "/vehicle/fix", "observations": "/flow/innovation", "plans": "/plan/controls", "surfacings": "/plan/outcome"}
        rows = ", ".join(f"{name} ({by_topic.get(topic, 0)})" for name, topic in {**tables, "events": "/log"}.items())
        times = " to ".join(time_text(end) for end in (ends.message_start_time, ends.message_end_time))
        return f"Result {self.path.name}, {times}\n  {held}; tables {rows}, innovations, dives, plan_tracks"

    @cached_property
    def estimate(self) -> FlowEstimate:
        """The last estimate.

        Raises:
            ForecastError: The result holds none.
        """
        return read_estimate(self.path)

    @cached_property
    def fixes(self) -> "pd.DataFrame":
        """Positions: longitude and latitude [degrees], depth [m] (NaN when unknown), whether dead reckoned."""
        rows = []
        for time_ns, fix in self._foxglove("/vehicle/fix"):
            about = {pair.key: pair.value for pair in fix.metadata}
            depth = float(about.get("depth", "nan"))
            rows.append((time_ns, fix.longitude, fix.latitude, depth, about.get("dead_reckoned") == "1"))
        return _table(rows, "time longitude latitude depth dead_reckoned")

    @cached_property
    def observations(self) -> "pd.DataFrame":
        """Measurements with what was done with them: a row each, the single values of ``replay_kit.Innovation``.

        ``rms_innovation``, ``rms_residual`` and ``rms_prior_innovation`` [m/s] are over the components of the bins used.
        """
        table = self._own("/flow/innovation", "Innovation")
        squares = self.innovations.set_index("observation", append=False)
        for name in _RMS:
            both = (squares[f"{name}_east"] ** 2 + squares[f"{name}_north"] ** 2).groupby(level=0).sum()
            total = both.reindex(range(len(table)), fill_value=0.0).to_numpy()
            table[f"rms_{name}"] = np.sqrt(total / np.where(table["dof"] > 0, table["dof"], np.nan))
        return table

    @cached_property
    def innovations(self) -> "pd.DataFrame":
        """Bins of the measurements: a row each, the lists of ``replay_kit.Innovation``; ``observation`` is the row in ``observations``.

        Values of a list that a measurement does not have are NaN.
        """
        import pandas as pd

        # as plain numbers, because a million messages do not fit into memory
        found = {field.name: array("d") for field in MESSAGES["Innovation"] if field.repeated}
        times, dives, counts = array("q"), array("q"), array("q")
        for value in self._decoded("/flow/innovation", "Innovation"):
            count = len(value.depth)
            times.append(value.timestamp.ToNanoseconds())
            dives.append(value.dive)
            counts.append(count)
            for name, numbers in found.items():
                each = getattr(value, name)
                numbers.extend(each if len(each) == count else repeat(np.nan, count))
        of_profile = {"time": np.array(times, dtype="datetime64[ns]"), "observation": np.arange(len(times)), "dive": np.array(dives)}
        columns = {name: np.repeat(column, counts) for name, column in of_profile.items()}
        columns |= {name: np.array(numbers) for name, numbers in found.items()}
        return pd.DataFrame(columns).astype({"flags": np.int32, "reasons": np.uint32}).set_index("time")

    @cached_property
    def dives(self) -> "pd.DataFrame":
        """Dives: start, end, number of profiles and bins used, RMS values [m/s] as in ``observations``, NIS per degree of freedom."""
        import pandas as pd

        table = self.observations.reset_index()
        used = table[table["accepted"] & (table["dive"] > 0)]
        groups, dof = used.groupby("dive"), used.groupby("dive")["dof"].sum()
        means = {f"rms_{name}": np.sqrt((used[f"rms_{name}"] ** 2 * used["dof"]).groupby(used["dive"]).sum() / dof) for name in _RMS}
        columns = {"start": groups["time"].min(), "end": groups["time"].max(), "profiles": groups.size(), "bins": dof // 2}
        return pd.DataFrame({**columns, **means, "nis_per_dof": groups["nis"].sum() / dof})

    @cached_property
    def plans(self) -> "pd.DataFrame":
        """Plans: a row each, the single values of ``replay_kit.Plan``."""
        return self._own("/plan/controls", "Plan")

    @cached_property
    def plan_tracks(self) -> "pd.DataFrame":
        """Predicted tracks of the plans: time, longitude and latitude [degrees], depth [m]; ``plan`` is the row in ``plans``.

        ``bottom`` is the depth of the bottom under the track [m]; NaN without a bathymetry.
        """
        with self.path.open("rb") as file:
            frame = next(record.metadata for record in make_reader(file).iter_metadata() if record.name == "frame map")
        projection = Projection(float(frame["longitude"]), float(frame["latitude"]))
        rows: list[tuple[Any, ...]] = []
        for number, plan in enumerate(self._decoded("/plan/controls", "Plan")):
            start = plan.timestamp.ToNanoseconds()
            times = start + np.rint(1e9 * np.asarray(plan.track_time)).astype(np.int64)
            places = to_geographic(projection, plan.track_east, plan.track_north)
            bottom = plan.track_bottom or [np.nan] * len(times)
            rows += zip(times, *places, plan.track_depth, [number] * len(times), bottom, strict=True)
        return _table(rows, "time longitude latitude depth plan bottom")

    @cached_property
    def surfacings(self) -> "pd.DataFrame":
        """Surfacings that plans predicted beside the actual ones: a row each, the values of ``replay_kit.PlanOutcome``."""
        return self._own("/plan/outcome", "PlanOutcome")

    @cached_property
    def events(self) -> "pd.DataFrame":
        """Events: level and message."""
        return _table([(time_ns, _LEVELS[event.level], event.message) for time_ns, event in self._foxglove("/log")], "time level message")

    def _foxglove(self, topic: str) -> Iterator[tuple[int, Any]]:
        with self.path.open("rb") as file:
            reader = make_reader(file, decoder_factories=[DecoderFactory()])
            for _, _, message, value in reader.iter_decoded_messages(topics=topic):
                yield message.log_time, value

    def _decoded(self, topic: str, name: str) -> Iterator[Any]:
        with self.path.open("rb") as file:
            for _, _, message in make_reader(file).iter_messages(topics=topic):
                yield decode(name, message.data)

    def _own(self, topic: str, name: str) -> "pd.DataFrame":
        """Return the single values of the messages of a topic: times as dates, each part of a place and the like as a column.

        Parts that a message does not have are NaN.
        """
        single = [field for field in MESSAGES[name] if not field.repeated]
        parts = {field.name: [part.name for part in MESSAGES[field.type.removeprefix(_OWN)]] for field in single if _OWN in field.type}
        columns = [text for field in single for text in ([f"{field.name}_{part}" for part in parts.get(field.name, ())] or [field.name])]
        rows = []
        for value in self._decoded(topic, name):
            row: list[Any] = []
            for field in single:
                found = getattr(value, field.name)
                if field.name in parts:
                    known = value.HasField(field.name)
                    row += [getattr(found, part) if known else np.nan for part in parts[field.name]]
                else:
                    row.append(np.datetime64(found.ToNanoseconds(), "ns") if field.type == TIME else found)
            rows.append(row)
        return _table(rows, " ".join(columns).replace("timestamp", "time", 1))


def result_path(path: str | Path) -> Path:
    """Return the path of a result that ``replay`` wrote.

    Raises:
        LogError: The file is missing, or is no complete result.
        ConfigError: The path is neither text nor a ``Path``.
    """
    path = as_path(path, "result")
    try:
        with path.open("rb") as file:
            reader: McapReader = make_reader(file)
            names = {record.name for record in reader.iter_metadata()}
    except OSError as error:
        raise LogError(f"{path}: cannot read the result: {error.strerror}; check the path") from error
    except (McapError, ValueError, struct.error) as error:
        raise LogError(
            f"{path}: expected a complete result of replay-kit replay: {error!r}; replay-kit convert recovers the messages of a partial one"
        ) from error
    if "contract" not in names:
        raise LogError(f"{path}: an MCAP file, but no result of replay-kit (no metadata record 'contract'); open a log with open_log")
    return path


def _table(rows: list[Any], columns: str) -> "pd.DataFrame":
    """Return rows as a table, with the column ``time`` as its index."""
    import pandas as pd

    table = pd.DataFrame(rows, columns=columns.split())
    return table.assign(time=pd.to_datetime(table["time"])).set_index("time")
