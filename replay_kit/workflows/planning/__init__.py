"""Plans on an estimate: the planners behind the protocol that a replay calls, and the mission that ``plan`` makes.

``adapters`` binds glides and missions to ``[planner]``; ``inputs`` reads estimates, no-go areas and the depth of the bottom; ``request`` is
what a mission is asked for, checked; ``currents`` what is known of the current at its times; ``mission`` plans it and
flies it through samples of the estimate; ``outputs`` writes it.
"""

from typing import TYPE_CHECKING

from replay_kit.core.extensions import on_demand

if TYPE_CHECKING:
    from replay_kit.workflows.planning.adapters import GlidePlanner, MissionPlanner, planner_of

__all__ = ["GlidePlanner", "MissionPlanner", "planner_of"]

# what is asked for is checked without the planners, which take seconds to load
__getattr__ = on_demand(
    globals(), dict.fromkeys(("GlidePlanner", "MissionPlanner", "planner_of"), "adapters")
)
