"""The estimates that a mission is planned on."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from replay_kit.core.as_flown import AsFlown
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.load import load
from replay_kit.results import read_estimate
from replay_kit.show.status.held import read_held
from replay_kit.workflows.planning.currents import KnownCurrent, known_current


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
