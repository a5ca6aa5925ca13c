"""One addition of each kind to replay-kit, which finds them by the entry points in ``pyproject.toml``."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from planners.request import Objective, Weights
from replay_kit.config.run import EstimatorConfig
from replay_kit.core.grid import Ensemble
from replay_kit.core.observation import LinearMeasurement, Observation
from replay_kit.estimator import Estimator
from replay_kit.estimator.baselines import nearest_member
from replay_kit.logs.netcdf.dialect import Dialect
from replay_kit.measurements.checks.fold import Context, Found, Memory, Rows, latest_rows
from replay_kit.results.views.contents import Contents
from replay_kit.show.page.page import Section

#: EGO, the French gliders' form.
EGO = Dialect(
    "ego",
    "EGO",
    "juld current_east current_north",
    {
        "time": "juld",
        "longitude": "longitude",
        "latitude": "latitude",
        "depth": "glider_depth",
        "dive": "phase_number",
        "dac_east": "current_east",
        "dac_north": "current_north",
    },
)


def radial(payload: Mapping[str, Any]) -> LinearMeasurement | str:
    """Return the current at a place along one direction, as a radar station that sends each of its radials by itself measures it."""
    place = 0, payload["longitude"], payload["latitude"]
    if not payload["error"] > 0.0:
        return "radial without an error"
    return Observation.component(place, 1.0, payload["towards"], payload["speed"], payload["error"])


def build_closest(ensemble: Ensemble, config: EstimatorConfig) -> Estimator:
    """Return an estimator that takes the member nearest to what was measured: what others must beat."""
    return nearest_member(ensemble, config)


def repeated_times(memory: Memory, pings: Rows, context: Context) -> tuple[Memory, list[Found]]:
    """Return that the clock stands still: four pings in a row have one time.

    Args:
        memory: ``time`` (4,) of the last pings [ns, UTC].
        pings: Of one instrument.
        context: Is not asked.
    """
    times = latest_rows(memory, "time", pings["time"], 4)
    alike = (times == times[:, :1]).all(axis=1)
    words = "a stopped clock", "mend the log"
    found = pings.first(alike, "clock stands still", lambda at: "4 pings of one time", *words)
    return {"time": times[-1]}, found


def depths_section(contents: Contents) -> Section:
    """Return the deepest position in words."""
    deepest = np.nanmax(contents.track.depth)
    return Section("depths", "Depths", f"<p>The deepest position lies at {deepest:.0f} m.</p>")


#: The mission with the fewest surfacings: each is a risk.
SURFACINGS = Objective(Weights(time=1.0), lambda found: float(len(found.yo_depths)))
