"""The current beside an estimate, as plans and their samples reckon with it."""

from collections.abc import Sequence
from math import ceil

import numpy as np

from planners.mission.flight.currents import Flow, LocalSample
from replay_kit.core.flow.local import LocalCurrent
from replay_kit.core.geodesy import heading_deg

# m/s; less takes a dive of three hours less than 100 m aside, and is left to the samples
_NOTICED = 0.01
# Times of a course in the shortest decorrelation time: halfway between two, linear, its spread is 4 % too small at most.
_A_SCALE = 6


def is_noticed(local: LocalCurrent | None) -> bool:
    """Return whether plans reckon with the expected current beside the estimate."""
    return local is not None and float(np.hypot(*local.velocity(local.time_ns))) > _NOTICED


def with_courses(
    samples: Sequence[Flow], local: LocalCurrent, begin_ns: int, seconds: float, seed: int
) -> list[LocalSample]:
    """Return samples with a course each of the current beside the estimate: what it differs by from the one that plans reckon with.

    Args:
        samples: Of the estimate, and of what plans reckon with.
        local: The current beside the estimate.
        begin_ns: From when on it is needed [ns, UTC].
        seconds: For how long.
        seed: Of the draws.
    """
    step = float(local.scale.min()) / _A_SCALE
    times = begin_ns + np.round(1e9 * step * np.arange(1 + max(ceil(seconds / step), 1))).astype(
        np.int64
    )
    reckoned = [
        local.velocity(time) if is_noticed(local) else np.zeros(2) for time in times.tolist()
    ]
    courses = local.sample(times.tolist(), len(samples), seed) - np.array(reckoned)
    return [
        LocalSample(sample, times, course) for sample, course in zip(samples, courses, strict=True)
    ]


def local_notes(
    local: LocalCurrent | None, begin_ns: int, left_out: bool = False
) -> tuple[str, ...]:
    """Return what the dives so far found beside the estimate; nothing where it is little.

    Args:
        local: The current beside the estimate.
        begin_ns: When the plan begins [ns, UTC].
        left_out: Whether the plan does not reckon with it.
    """
    if local is None:
        return ()
    error, (east, north) = local.standard_error(begin_ns), local.velocity(begin_ns)
    if max(error, float(np.hypot(east, north))) < _NOTICED:
        return ()
    use = "the samples reckon with it, less and less with time"
    if left_out:
        use = "the errors of this plan leave it out"
    elif is_noticed(local):
        use = f"the plan and {use}"
    return (
        f"the dives so far met a current beside the estimate's: {100.0 * np.hypot(east, north):.0f} cm/s towards "
        f"{float(heading_deg(east, north)):.0f} degrees, with a standard error of {100.0 * error:.0f} cm/s at the start; {use}",
    )
