"""Data of a status, read from the result with as few messages decoded as possible."""

import math
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from typing import Any, NamedTuple

import numpy as np

from replay_kit.core.geodesy import heading_deg
from replay_kit.core.grid import Projection
from replay_kit.core.plan import Plan
from replay_kit.results.geojson import plan_of
from replay_kit.results.innovations import Columns, blocks_in, joined_blocks, picked_rows
from replay_kit.results.mcap.schemas import decode
from replay_kit.results.mcap.topics import CONFIG_NAME, naming_errors
from replay_kit.results.outcome.outcome import Outcome
from replay_kit.results.reader import ResultReader, check_result
from replay_kit.show.sentences import SOURCES

#: Values of an answer by name.
Values = dict[str, Any]
# Two plans tell what changed; their surfacings and the measurements between them tell why.
_PLANS, _OUTCOMES = 2, 50


class Fix(NamedTuple):
    """Position of the vehicle.

    Attributes:
        time_ns: Time [ns, UTC].
        longitude: Longitude [degrees east].
        latitude: Latitude [degrees north].
        reckoned: Whether the position is dead reckoned, not measured.
    """

    time_ns: int
    longitude: float
    latitude: float
    reckoned: bool


class Held(NamedTuple):
    """Data at the end of a result.

    Attributes:
        name: File name.
        last_ns: Time of the last message but plans for later [ns, UTC].
        metadata: Records by name.
        settings: Effective configuration.
        outcome: Of the run; None if unfinished.
        projection: Local frame.
        fixes: The first, the last one a day older than the last, and the last.
        reckoned: Dead-reckoned position, if newer.
        plans: Last two plans.
        outcomes: Last surfacings, ``replay_kit.PlanOutcome``.
        dive: Innovations of the last dive; None without any.
    """

    name: str
    last_ns: int
    metadata: Mapping[str, Mapping[str, str]]
    settings: Mapping[str, Any]
    outcome: Outcome | None
    projection: Projection
    fixes: Sequence[Fix]
    reckoned: Fix | None
    plans: Sequence[Plan]
    outcomes: Sequence[Any]
    dive: Columns | None

    @property
    def goal(self) -> tuple[float, float, float] | None:
        """Longitude, latitude [degrees] and depth [m] of the goal of the last plan or the run; None without one."""
        if self.plans:
            goal = self.plans[-1].goal
            return goal.longitude, goal.latitude, goal.depth
        text = self.metadata.get("replay_kit.options", {}).get("goal", "")
        return tuple(float(part) for part in text.split(",")) if text else None  # type: ignore[return-value]

    @property
    def fix_error(self) -> float:
        """Standard error of a fix [m]; 0 if not set."""
        return float(self.settings.get("measurements", {}).get("fix_std", 0.0))


def course(velocity: Mapping[str, float]) -> tuple[float, float]:
    """Return speed [m/s] and direction [degrees clockwise from true north] of a velocity ``east``, ``north``."""
    east, north = velocity["east"], velocity["north"]
    return math.hypot(east, north), float(heading_deg(east, north))


def read_held(reader: ResultReader) -> Held:
    """Return the status data of a result, or of one vehicle's part of it.

    Raises:
        LogError: The file is missing or not a complete result.
    """
    check_result(reader)
    ends = reader.summary.statistics
    assert ends is not None
    with naming_errors(reader.path):
        fixes, reckoned = _positions(reader)
        plans = [plan_of(one) for one in _last(reader, "/plan/controls", "Plan", _PLANS)]
        outcomes = _last(reader, "/plan/outcome", "PlanOutcome", _OUTCOMES)
        dive = _last_dive(reader)
    known = [
        *(fix.time_ns for fix in fixes),
        *(one.timestamp.ToNanoseconds() for one in outcomes),
        *([] if dive is None else dive["timestamp"].tolist()),
    ]
    return Held(
        name=reader.name,
        last_ns=max(
            [*known, *([reckoned.time_ns] if reckoned else [])], default=ends.message_end_time
        ),
        metadata=reader.metadata,
        settings=tomllib.loads(reader.text(CONFIG_NAME)),
        outcome=reader.outcome,
        projection=reader.projection,
        fixes=fixes,
        reckoned=reckoned,
        plans=plans,
        outcomes=outcomes,
        dive=dive,
    )


_DAY_NS = 86_400 * 10**9


def _last(reader: ResultReader, topic: str, name: str, most: int) -> list[Any]:
    """Return the last messages of a topic."""
    newest = islice(reader.messages(topic, newest=True), most)
    return [decode(name, data) for _, data in newest][::-1]


def _last_dive(reader: ResultReader) -> Columns | None:
    """Return the innovations of the last dive; the last ones of a vehicle that does not dive."""
    kept: list[Columns] = []
    for whole in blocks_in(reader, newest=True):
        # the vehicle's own: others' are counted by dives of their own
        block = picked_rows(whole, ~np.isin(whole["mean_current_kind"], [*SOURCES]))
        if not block["dive"].size:
            continue
        dive = (kept[0] if kept else block)["dive"][-1]
        # those after the last row of another dive
        of_dive = np.logical_and.accumulate(block["dive"][::-1] == dive)[::-1]
        kept.insert(0, picked_rows(block, of_dive))
        if not of_dive.all() or (not dive and sum(one["dive"].size for one in kept) >= _OUTCOMES):
            break
    if not kept:
        return None
    rows = (found := joined_blocks(kept))["dive"].size
    return found if found["dive"][-1] else picked_rows(found, np.arange(rows) >= rows - _OUTCOMES)


def _positions(reader: ResultReader) -> tuple[list[Fix], Fix | None]:
    """Return the fixes and the last dead-reckoned position, see ``Held``."""

    def fixes(newest: bool = True, until_ns: int | None = None) -> Iterator[Fix]:
        for time_ns, message in reader.decoded("/vehicle/fix", newest, until_ns):
            told = [(pair.key, pair.value) for pair in message.metadata]
            yield Fix(time_ns, message.longitude, message.latitude, ("dead_reckoned", "1") in told)

    def measured(newest: bool = True, until_ns: int | None = None) -> Fix | None:
        return next((fix for fix in fixes(newest, until_ns) if not fix.reckoned), None)

    end, last = next(fixes(), None), measured()
    if last is None or end is None:
        return [], end
    found = measured(newest=False), measured(until_ns=last.time_ns - _DAY_NS), last
    return [
        fix for fix in found if fix is not None
    ], end if end.reckoned and end.time_ns > last.time_ns else None
