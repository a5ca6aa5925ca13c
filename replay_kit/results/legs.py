"""The legs of a mission, which a plan's statistics hold as JSON."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

from replay_kit.core.surfacing import Ellipse


def plan_legs(statistics: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the legs of a mission from the statistics of its plan, in order; none of a glide."""
    return [json.loads(statistics[name]) for name in sorted(statistics) if name.startswith("leg_")]


def planned_ellipses(legs: Sequence[Mapping[str, float]]) -> list[Ellipse]:
    """Return the ellipses of the surfacings of a plan's legs, of those that have one."""
    names = ("longitude", "latitude", "major_m", "minor_m", "bearing_deg")
    return [
        Ellipse(*(leg[f"ellipse_{name}"] for name in names))
        for leg in legs
        if "ellipse_major_m" in leg
    ]
