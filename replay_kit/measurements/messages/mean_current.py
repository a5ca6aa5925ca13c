"""A dive's depth-averaged current as its message states it."""

import math
from collections.abc import Mapping
from typing import Any

from replay_kit.core.observation import Fix
from replay_kit.measurements.current.mean import MeanCurrent
from replay_kit.measurements.messages.fields import STD_BELIEVED, dive_number, number

_NS = 1_000_000_000


def depth_averaged_current(payload: Mapping[str, Any]) -> MeanCurrent | str:
    """Return the mean current of a ``replay_kit.DepthAveragedCurrent``, or why there is none."""
    velocity = number(payload.get("dac_eastward")), number(payload.get("dac_northward"))
    if not math.isfinite(sum(velocity)):
        return "depth-averaged current: it is not a number"
    std = number(payload.get("error"))
    start, end = (_fix(payload.get(name)) for name in ("start_fix", "end_fix"))
    believed = std if STD_BELIEVED[0] <= std <= STD_BELIEVED[1] else math.nan
    dive, inverted = dive_number(payload.get("dive")), bool(payload.get("inverted_in"))
    return MeanCurrent(
        velocity, believed, start, end, dive, number(payload.get("max_depth")), inverted
    )


def _fix(stated: Any) -> Fix | None:
    """Return a fix of a payload; None when it does not hold one whole."""
    if not isinstance(stated, Mapping) or not isinstance(stated.get("time"), Mapping):
        return None
    seconds, rest = (number(stated["time"].get(name)) for name in ("sec", "nsec"))
    longitude, latitude = number(stated.get("lon")), number(stated.get("lat"))
    if not (
        0.0 <= seconds < 2**33
        and 0.0 <= rest < 2 * _NS
        and math.isfinite(longitude)
        and abs(latitude) <= 90.0
    ):
        return None
    return Fix(int(seconds) * _NS + int(rest), longitude, latitude)
