"""Parts of the messages that readers of foreign formats make: stamps, fixes, numbers that may be unknown."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

PING, FIX = "replay_kit.AdcpPing", "foxglove.LocationFix"
_NS = 1_000_000_000


def stamp(time_ns: int) -> dict[str, int]:
    """Return a time [ns, UTC] as seconds and nanoseconds."""
    return {"sec": time_ns // _NS, "nsec": time_ns % _NS}


def number(value: float) -> float | None:
    """Return a number, or None when it is not finite: JSON has no NaN."""
    return value if math.isfinite(value) else None


def numbers(values: NDArray[Any]) -> list[Any]:
    """Return an array as nested lists with None for what is not finite."""
    values = np.asarray(values, dtype=np.float64)
    plain: NDArray[Any] = values.astype(object)
    plain[~np.isfinite(values)] = None
    return list(plain.tolist())


def location_fix(
    time_ns: int, longitude: float, latitude: float, depth: float, dead_reckoned: bool, error: float
) -> dict[str, Any]:
    """Return a ``foxglove.LocationFix``.

    Args:
        time_ns: [ns, UTC].
        longitude: [degrees east].
        latitude: [degrees north].
        depth: [m], positive down.
        dead_reckoned: Whether the position was computed, not measured.
        error: Standard deviation of each horizontal component [m]; NaN or 0 when unknown.
    """
    stated = error > 0.0
    variance = float(error) ** 2 if stated else 0.0
    return {
        "timestamp": stamp(time_ns),
        "frame_id": "vehicle",
        "latitude": float(latitude),
        "longitude": float(longitude),
        "altitude": -float(depth),
        "position_covariance": [variance, 0.0, 0.0, 0.0, variance, 0.0, 0.0, 0.0, 0.0],
        "position_covariance_type": 1 if stated else 0,
        "metadata": [
            {"key": "depth", "value": f"{depth:.3f}"},
            {"key": "dead_reckoned", "value": "true" if dead_reckoned else "false"},
        ],
    }
