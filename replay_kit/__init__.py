"""replay-kit: what was the water doing, and where should the vehicle go next?

::

    import replay_kit as rk

    result = rk.replay("glider.mcap", "ensemble.nc")
    result.estimate.velocity_at(152.6, -40.0, 150.0)

Each name is imported when it is first asked for.
"""

from typing import TYPE_CHECKING

from replay_kit.core import __version__
from replay_kit.core.extensions import on_demand

if TYPE_CHECKING:
    from replay_kit.config.run import RunConfig
    from replay_kit.core.errors import ReplayKitError
    from replay_kit.core.flow.estimate import FlowEstimate
    from replay_kit.core.flow.file import load as open_estimate
    from replay_kit.core.grid import Ensemble
    from replay_kit.core.observation import Observation
    from replay_kit.core.plan import Place, Plan
    from replay_kit.logs import open_log
    from replay_kit.measurements import observations
    from replay_kit.show.notebook import Result
    from replay_kit.workflows.library.calls import open_ensemble, plan, replay
    from replay_kit.workflows.library.live import live
    from replay_kit.workflows.sound import open_result

__all__ = [
    "Ensemble",
    "FlowEstimate",
    "Observation",
    "Place",
    "Plan",
    "ReplayKitError",
    "Result",
    "RunConfig",
    "__version__",
    "live",
    "observations",
    "open_ensemble",
    "open_estimate",
    "open_log",
    "open_result",
    "plan",
    "replay",
]

__getattr__ = on_demand(__name__, __file__)


def __dir__() -> list[str]:
    return sorted(__all__)
