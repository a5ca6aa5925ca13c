"""The last estimate in a result MCAP, read back for planning and analysis."""

from pathlib import Path

from mcap.exceptions import McapError
from mcap.reader import make_reader

from replay_kit.core.errors import ForecastError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.load import load_bytes
from replay_kit.core.inputs import open_input
from replay_kit.core.paths import as_path
from replay_kit.results.topics import ESTIMATE_NAME, WINDOW_NAME, WINDOWS_RECORD


def read_windows(path: str | Path) -> tuple[FlowEstimate, ...]:
    """Return the estimates of all windows of a result, in order; that of the last one is ``read_estimate``'s.

    Raises:
        ForecastError: As for ``read_estimate``.
    """
    last, path = read_estimate(path), as_path(path, "result")
    with path.open("rb") as file:
        reader = make_reader(file)
        records = [
            record.metadata for record in reader.iter_metadata() if record.name == WINDOWS_RECORD
        ]
        left = {
            int(record.name.removeprefix(WINDOW_NAME).removesuffix(".nc")): record
            for record in reader.iter_attachments()
            if record.name.startswith(WINDOW_NAME)
        }
    withdrawn = int(records[0]["withdrawn"]) if records else 0
    return (
        *(
            load_bytes(left[number].data, f"{path}#{left[number].name}")
            for number in sorted(left)
            if number > withdrawn
        ),
        last,
    )


def read_estimate(path: str | Path) -> FlowEstimate:
    """Return the last estimate of a result MCAP, from its attachment ``estimate.nc``.

    Args:
        path: A file written by ``ResultWriter``.

    Raises:
        ForecastError: The file is no readable MCAP or carries no estimate.
    """
    path = as_path(path, "result")
    try:
        with open_input(path) as file:
            attachments = [
                record.data
                for record in make_reader(file).iter_attachments()
                if record.name == ESTIMATE_NAME
            ]
    except OSError as error:
        raise ForecastError(f"{path}: cannot read the result: {error.strerror}") from error
    except (McapError, ValueError) as error:
        raise ForecastError(f"{path}: not a complete MCAP: {error!r}") from error
    if not attachments:
        raise ForecastError(
            f"{path}: carries no {ESTIMATE_NAME}, as a result written without its estimate, of an unfinished run or of a plan alone; "
            "its fixes, innovations and plans can be read, but no current: replay the log for an estimate"
        )
    return load_bytes(attachments[-1], f"{path}#{ESTIMATE_NAME}")
