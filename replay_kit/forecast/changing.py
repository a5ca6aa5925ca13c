"""A truth at all leads or times of its file."""

from pathlib import Path

import numpy as np

from replay_kit.config.run import ForecastConfig
from replay_kit.core.errors import ForecastError
from replay_kit.core.grid import Ensemble
from replay_kit.forecast.blocks import open_collection
from replay_kit.forecast.layout import U
from replay_kit.forecast.names import find_lead, find_time
from replay_kit.forecast.reader import read_truth


def read_changing_truth(
    spec: str, config: ForecastConfig, reference_time: str
) -> tuple[Ensemble, ...]:
    """Return a truth at each lead of its file, or at each time where it has no leads, in their order.

    Args:
        spec: As in ``read_truth``.
        config: As in ``read_truth``; it chooses no lead, and the first of several times when the file has leads too.
        reference_time: Time of lead 0, ISO 8601 UTC, where neither the file nor the configuration states one.

    Raises:
        ForecastError: As in ``read_truth``; or the file has one time only, or leads without a unit of time.
    """
    name = spec.partition("#")[0]
    with open_collection(Path(name), None) as found:
        ds = found.blocks[0].parts[0].ds
        lead, time = find_lead(ds, ds[U].dims), find_time(ds, ds[U].dims)
        if lead is not None:
            steps = [{"lead": float(value)} for value in ds[lead].values]
        elif time is not None:
            steps = [
                {"time": np.datetime_as_string(value.astype("datetime64[ns]"))}
                for value in ds[time].values
            ]
        else:
            raise ForecastError(
                f"{name}: a truth that changes needs leads or times; the file has neither as a dimension"
            )
    if config.lead is not None or (lead is None and config.time is not None):
        raise ForecastError(
            f"{name}: a truth that changes goes through all leads and times; choose none of them"
        )
    if len(steps) < 2:
        raise ForecastError(
            f"{name}: a truth that changes needs at least two leads or times, got one"
        )
    first = read_truth(spec, config.model_copy(update=steps[0]))
    if first.time_ns is None:
        config = config.model_copy(update={"reference_time": reference_time})
    truths = tuple(read_truth(spec, config.model_copy(update=step)) for step in steps)
    if truths[0].time_ns is None:
        raise ForecastError(
            f"{name}: its leads have no unit of time; give the lead's attribute units, such as days"
        )
    return truths
