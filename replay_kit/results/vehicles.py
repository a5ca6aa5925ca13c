"""Names in results of several vehicles with one estimate.

Topics, records and attachments of the estimate are those of any result. Those of one vehicle have its name as prefix: ``/sg1/fix`` stands
for ``/vehicle/fix``, ``/sg1/innovation`` for ``/flow/innovation``, ``/sg1/plan/path`` for ``/plan/path``, the record
``sg1/replay_kit.as_flown`` for ``replay_kit.as_flown``.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

#: Record of a result of several vehicles: name to logs and goal, as JSON.
VEHICLES_RECORD = "replay_kit.vehicles"
#: Names that no vehicle may have, as topics begin with them.
RESERVED = ("flow", "input", "log", "plan", "tf", "vehicle")
_SHARED = ("/flow/estimate", "/flow/grid/", "/flow/arrows/", "/flow/surface", "/plan/seabed")
_SHORT = {
    "/vehicle/fix": "fix",
    "/flow/innovation": "innovation",
    "/flow/consistency": "consistency",
    "/flow/surfacing": "surfacing",
}


@dataclass(frozen=True, slots=True)
class VehicleRecord:
    """Record of one vehicle in a result of several.

    Attributes:
        name: Name of the vehicle.
        logs: Keys of its logs among the inputs.
        goal: Goal as in the option; empty without one.
        why_not: Why its measurements were not used; else empty.
    """

    name: str
    logs: tuple[str, ...]
    goal: str = ""
    why_not: str = ""

    def to_text(self) -> str:
        """Return the text of the record."""
        return json.dumps({"logs": self.logs, "goal": self.goal, "why_not": self.why_not})


def vehicle_records(metadata: Mapping[str, Mapping[str, str]]) -> tuple[VehicleRecord, ...]:
    """Return the vehicles in a result's metadata in order of their names; empty for a single vehicle."""
    held = {name: json.loads(text) for name, text in metadata.get(VEHICLES_RECORD, {}).items()}
    return tuple(
        VehicleRecord(name, tuple(one["logs"]), one["goal"], one["why_not"])
        for name, one in sorted(held.items())
    )


def topic_of(vehicle: str, topic: str) -> str:
    """Return the topic of a vehicle's messages; unchanged for a single vehicle (empty name) and for the estimate."""
    if not vehicle or topic.startswith(_SHARED):
        return topic
    return f"/{vehicle}/{_SHORT.get(topic, topic[1:])}"


def name_of(vehicle: str, name: str) -> str:
    """Return the name of a vehicle's record or attachment; unchanged for a single vehicle."""
    return f"{vehicle}/{name}" if vehicle else name


def part_path(path: Path, vehicle: str, folder: Path) -> Path:
    """Return the file of one vehicle in a folder, such as ``out.sg1.mcap`` for ``out.mcap``."""
    return folder / f"{path.stem}.{vehicle}{path.suffix}"
