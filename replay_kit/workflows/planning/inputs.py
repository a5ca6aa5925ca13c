"""Inputs of a plan: estimates, no-go areas, bathymetry."""

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
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
    from replay_kit.results.reader import ResultReader
    from replay_kit.show.status.held import Held
    from replay_kit.workflows.planning.currents import KnownCurrent
    from replay_kit.workflows.sound import Sound


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


def planned_on(request: PlanRequest, config: PlannerConfig) -> PlannedOn:
    """Return the inputs of a plan, read from the files of its request.

    Args:
        request: Request of the plan.
        config: ``[planner]``.

    Raises:
        ReplayKitError: A file cannot be read, the estimates are not in order of time, or a place is outside their water.
    """
    announce("reading the estimate")
    named = bool(request.glider or request.start is None)
    places = () if named else (request.start_place, *request.goals)
    files = [(path, read_flow(path, places)) for path in request.flows]
    region, bottom = files[0][1].flow.grid, None
    if not (request.glider or request.mooring):
        locate_all(Region(region, config.depth_limit), request.start_place, request.goals)
    known, flown = read_known(files, config.flow_step)
    areas: tuple[NoGo, ...] = ()
    notes = tuple(note for _, file in files for note in file.notes)
    if request.no_go is not None:
        from replay_kit.workflows.planning.areas import area_notes, read_areas

        areas, notes = read_areas(request.no_go), notes + area_notes(request.no_go, region)
    if request.bathymetry is not None:
        from replay_kit.workflows.planning.bathymetry import bathymetry_notes, read_bathymetry

        bottom = read_bathymetry(request.bathymetry, region)
        notes += bathymetry_notes(bottom, region)
    exit_code = max(file.exit_code for _, file in files)
    return PlannedOn(known, flown, areas, bottom, notes, exit_code)


@dataclass(frozen=True, slots=True, eq=False)
class FlowFile:
    """Content of a file with an estimate.

    Attributes:
        flow: The estimate.
        held: Other content of a result by vehicle, see ``ends_of``; empty for a pure estimate.
        notes: Losses of the file, or a missing checksum.
        exit_code: Exit code of a command that uses it: 4 if something was lost, else 0.
    """

    flow: FlowEstimate
    held: "Mapping[str, Held]"
    notes: tuple[str, ...]
    exit_code: int = 0

    @property
    def flown(self) -> dict[str, AsFlown]:
        """Flight parameters in the file by vehicle name, empty for a single one."""
        metadata = {name: held.metadata for name, held in self.held.items()}
        if saved := self.flow.about.get(AS_FLOWN):
            metadata[""] = {AS_FLOWN: json.loads(saved)}
        found = {name: AsFlown.in_metadata(records) for name, records in metadata.items()}
        return {name: flown for name, flown in found.items() if flown is not None}


def read_known(
    files: Sequence[tuple[Path, FlowFile]], flow_step: float
) -> "tuple[KnownCurrent, dict[str, AsFlown]]":
    """Return the current in one or more files, and the latest flight parameters in them by vehicle name.

    The time of the last fix is known for a single result.

    Args:
        files: Files with their content, several in order of time.
        flow_step: Time between the flows of a changing estimate [s].

    Raises:
        ReplayKitError: The files are not in order of time.
    """
    from replay_kit.workflows.planning.currents import known_current

    known = known_current([(path, file.flow) for path, file in files], flow_step)
    each = [file for _, file in files]
    ends = [held.fixes[-1].time_ns for held in each[0].held.values() if held.fixes]
    if len(each) == 1 and ends:
        known = replace(known, last_fix_ns=max(ends))
    return known, {name: flown for file in each for name, flown in file.flown.items()}


def read_flow(path: Path, places: Sequence[Place] = ()) -> FlowFile:
    """Return the estimate in a NetCDF file of ``--save-estimate`` or a result MCAP, recognised by its first bytes.

    Args:
        path: The file.
        places: Positions that select the window of a result; the last window if it holds them, or if none does.

    Raises:
        ReplayKitError: The file is missing or has no estimate.
    """
    if _is_result(path):
        with _opened(path) as (sound, reader):
            flow, held = reader.estimate(), _ends(reader)
            if not _holds(flow, places):
                flows = reversed(reader.estimates())
                flow = next((one for one in flows if _holds(one, places)), flow)
        return FlowFile(flow, held, sound.lines, sound.exit_code)
    return FlowFile(load(path), {}, ())


def ends_of(path: Path) -> "dict[str, Held]":
    """Return the end of a result, with last fix and goal, by vehicle name, empty for a single one; none of a pure estimate."""
    if not _is_result(path):
        return {}
    with _opened(path) as (_, reader):
        return _ends(reader)


def _ends(reader: "ResultReader") -> "dict[str, Held]":
    from replay_kit.show.status.held import read_held

    names = [vehicle.name for vehicle in reader.vehicles] or [""]
    return {name: read_held(reader.part(name)) for name in names}


@contextmanager
def _opened(path: Path) -> "Iterator[tuple[Sound, ResultReader]]":
    """Yield a result with valid checksums, and its reader."""
    from replay_kit.results.reader import ResultReader
    from replay_kit.workflows.sound import sound_result

    with sound_result(path) as sound:
        yield sound, ResultReader(sound.path, opened=sound.file)


def _holds(flow: FlowEstimate, places: Sequence[Place]) -> bool:
    box = bounds_of(flow.grid)
    return all(inside(box, place.longitude, place.latitude) for place in places)


def _is_result(path: Path) -> bool:
    with suppress(OSError), open_input(path) as file:
        return file.read(5) == b"\x89MCAP"
    return False
