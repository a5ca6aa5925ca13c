"""Inputs of a plan: estimates, no-go areas, bathymetry."""

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from planners.hazards.domain import Region, locate_all
from replay_kit.config.plan import PlanRequest
from replay_kit.config.planner import PlannerConfig
from replay_kit.core.as_flown import AS_FLOWN, AsFlown
from replay_kit.core.files.inputs import open_input
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.file import load
from replay_kit.core.grid import Grid
from replay_kit.core.plan import Place
from replay_kit.core.region import bounds_of, inside
from replay_kit.core.words.progress import announce

# the planners and what reads results load slowly: a place outside of an estimate is refused without them
if TYPE_CHECKING:
    from planners.hazards.areas import NoGo
    from planners.hazards.bottom import Bathymetry
    from replay_kit.show.status.held import Held
    from replay_kit.workflows.planning.currents import KnownCurrent


@dataclass(frozen=True, slots=True, eq=False)
class PlannedOn:
    """Inputs of a plan.

    Attributes:
        known: Current.
        flown: Known flight parameters by vehicle name, empty for a single one.
        no_go: No-go areas.
        bathymetry: Bottom depth; None without one.
        notes: Notes on the files.
        exit_code: 4 if part of a file was lost, else 0.
    """

    known: "KnownCurrent"
    flown: Mapping[str, AsFlown]
    no_go: "tuple[NoGo, ...]"
    bathymetry: "Bathymetry | None"
    notes: tuple[str, ...]
    exit_code: int = 0

    @property
    def region(self) -> Grid:
        """Region of the estimate."""
        return self.known.first.grid


def planned_on(
    request: PlanRequest, config: PlannerConfig, known: "Mapping[Path, FlowFile] | None" = None
) -> PlannedOn:
    """Return the inputs of a plan, read from the files of its request.

    Args:
        request: Request of the plan.
        config: ``[planner]``.
        known: Files that were read already.

    Raises:
        ReplayKitError: A file cannot be read, the estimates are not in order of time, or a place is outside their water.
    """
    announce("reading the estimate")
    files = [(known or {}).get(path) or read_flow(path) for path in request.flows]
    places = () if request.glider else (request.start_place, *request.goals)
    region, bottom = files[0].at(places).grid, None
    if not (request.glider or request.mooring):
        locate_all(Region(region, config.depth_limit), request.start_place, request.goals)
    current, flown = read_known(files, config.flow_step, places)
    areas: tuple[NoGo, ...] = ()
    notes = tuple(note for file in files for note in file.notes)
    if request.no_go is not None:
        from replay_kit.workflows.planning.areas import area_notes, read_areas

        areas = read_areas(request.no_go)
        notes += area_notes(request.no_go, areas, region)
    if request.bathymetry is not None:
        from replay_kit.workflows.planning.bathymetry import bathymetry_notes, read_bathymetry

        bottom = read_bathymetry(request.bathymetry, region)
        notes += bathymetry_notes(bottom, region)
    exit_code = max(file.exit_code for file in files)
    return PlannedOn(current, flown, areas, bottom, notes, exit_code)


@dataclass(frozen=True, slots=True, eq=False)
class FlowFile:
    """Content of a file with an estimate.

    Attributes:
        path: The file.
        flows: Estimates of its windows in order; the last one is that of its end.
        held: Other content of a result by vehicle, empty name for a single one; empty for a pure estimate.
        notes: Losses of the file, or a missing checksum.
        exit_code: Exit code of a command that uses it: 4 if something was lost, else 0.
    """

    path: Path
    flows: tuple[FlowEstimate, ...]
    held: "Mapping[str, Held]" = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    exit_code: int = 0

    def at(self, places: Sequence[Place] = ()) -> FlowEstimate:
        """Return the estimate of the last window that holds places; of the last one if none does."""

        def holds(flow: FlowEstimate) -> bool:
            box = bounds_of(flow.grid)
            return all(inside(box, place.longitude, place.latitude) for place in places)

        return next(filter(holds, reversed(self.flows)), self.flows[-1])

    @property
    def flown(self) -> dict[str, AsFlown]:
        """Flight parameters in the file by vehicle name, empty for a single one."""
        metadata = {name: held.metadata for name, held in self.held.items()}
        if saved := self.flows[-1].about.get(AS_FLOWN):
            metadata[""] = {AS_FLOWN: json.loads(saved)}
        found = {name: AsFlown.in_metadata(records) for name, records in metadata.items()}
        return {name: flown for name, flown in found.items() if flown is not None}


def read_known(
    files: Sequence[FlowFile], flow_step: float, places: Sequence[Place] = ()
) -> "tuple[KnownCurrent, dict[str, AsFlown]]":
    """Return the current in one or more files, and the latest flight parameters in them by vehicle name.

    The time of the last fix is known for a single result.

    Args:
        files: Files, several in order of time.
        flow_step: Time between the flows of a changing estimate [s].
        places: Positions that select the window of a result.

    Raises:
        ReplayKitError: The files are not in order of time.
    """
    from replay_kit.workflows.planning.currents import known_current

    known = known_current([(file.path, file.at(places)) for file in files], flow_step)
    ends = [held.fixes[-1].time_ns for held in files[0].held.values() if held.fixes]
    if len(files) == 1 and ends:
        known = replace(known, last_fix_ns=max(ends))
    return known, {name: flown for file in files for name, flown in file.flown.items()}


def read_flow(path: Path) -> FlowFile:
    """Return the content of a NetCDF file of ``--save-estimate`` or a result MCAP, recognised by its first bytes.

    Raises:
        ReplayKitError: The file is missing or has no estimate.
    """
    if not is_result(path):
        return FlowFile(path, (load(path),))
    from replay_kit.results.reader import ResultReader
    from replay_kit.show.status.held import read_held
    from replay_kit.workflows.sound import sound_result

    with sound_result(path) as sound:
        reader = ResultReader(sound.path, opened=sound.file)
        flows = reader.estimates()
        names = [vehicle.name for vehicle in reader.vehicles] or [""]
        held = {name: read_held(reader.part(name)) for name in names}
        return FlowFile(path, flows, held, sound.lines, sound.exit_code)


def is_result(path: Path) -> bool:
    """Return whether a file is a result, by its first bytes."""
    with suppress(OSError), open_input(path) as file:
        return file.read(5) == b"\x89MCAP"
    return False
