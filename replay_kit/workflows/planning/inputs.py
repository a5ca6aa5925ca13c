"""The estimates that a mission is planned on."""

from contextlib import suppress
from pathlib import Path

from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.load import load
from replay_kit.results import read_estimate


def read_flow(path: Path) -> FlowEstimate:
    """Return the estimate in a file: NetCDF of ``--save-estimate``, or a result MCAP, which its first bytes tell.

    Raises:
        ReplayKitError: The reader's error, when there is no such file or it holds no estimate.
    """
    with suppress(OSError), path.open("rb") as file:
        if file.read(5) == b"\x89MCAP":
            return read_estimate(path)
    return load(path)
