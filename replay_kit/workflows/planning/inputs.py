"""What a plan is made on: the estimates, the areas to keep out of, the bottom to stay above."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from planners import Bathymetry, NoGo
from replay_kit.config.plan import PlanRequest
from replay_kit.core.as_flown import AsFlown
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.load import load
from replay_kit.core.grid import Grid
from replay_kit.core.progress import announce
from replay_kit.results import read_estimate
from replay_kit.show.status.held import read_held
from replay_kit.workflows.planning.areas import area_notes, read_areas
from replay_kit.workflows.planning.bathymetry import bathymetry_notes, read_bathymetry
from replay_kit.workflows.planning.currents import KnownCurrent, known_current


@dataclass(frozen=True, slots=True, eq=False)
class PlannedOn:
    """What a plan is made on.

    Attributes:
        known: The current.
        flown: How the vehicle flew; None where that is not known.
        no_go: Areas that it keeps out of.
        bathymetry: Bottom that it stays above; None without.
        notes: What about the files of areas and of the bottom should be known.
    """

    known: KnownCurrent
    flown: AsFlown | None
    no_go: tuple[NoGo, ...]
    bathymetry: Bathymetry | None
    notes: tuple[str, ...]

    @property
    def region(self) -> Grid:
        """Where the estimate holds."""
        return self.known.first.grid


def planned_on(request: PlanRequest, flow_step: float) -> PlannedOn:
    """Return what a plan is made on, read from the files of its request.

    Args:
        request: What is asked for.
        flow_step: Between the flows that an estimate which changes is planned on [s].

    Raises:
        ReplayKitError: A file cannot be read, or the files of the current do not follow each other.
    """
    announce("reading the estimate")
    known, flown = read_known(request.flows, flow_step)
    region, bottom = known.first.grid, None
    areas: tuple[NoGo, ...] = ()
    notes: tuple[str, ...] = ()
    if request.no_go is not None:
        areas, notes = read_areas(request.no_go), area_notes(request.no_go, region)
    if request.bathymetry is not None:
        bottom = read_bathymetry(request.bathymetry, region)
        notes += bathymetry_notes(bottom, region)
    return PlannedOn(known, flown, areas, bottom, notes)


def read_known(paths: Sequence[Path], flow_step: float) -> tuple[KnownCurrent, AsFlown | None]:
    """Return what some files, one at least, know of the current, and how the vehicle flew by the last result among them, None without.

    The time of the vehicle's last fix is known where there is one file, a result.

    Args:
        paths: Each with an estimate; several hold for increasing times.
        flow_step: Between the flows that an estimate which changes is planned on [s].

    Raises:
        ReplayKitError: A file cannot be read, or the files do not follow each other.
    """
    known = known_current([(path, read_flow(path)) for path in paths], flow_step)
    results = [read_held(path) for path in paths if _is_result(path)]
    if not results:
        return known, None
    last = results[-1]
    if len(paths) == 1 and last.fixes:
        known = replace(known, last_fix_ns=last.fixes[-1].time_ns)
    return known, AsFlown.in_metadata(last.metadata)


def read_flow(path: Path) -> FlowEstimate:
    """Return the estimate in a file: NetCDF of ``--save-estimate``, or a result MCAP, which its first bytes tell.

    Raises:
        ReplayKitError: The reader's error, when there is no such file or it holds no estimate.
    """
    return read_estimate(path) if _is_result(path) else load(path)


def _is_result(path: Path) -> bool:
    with suppress(OSError), path.open("rb") as file:
        return file.read(5) == b"\x89MCAP"
    return False
