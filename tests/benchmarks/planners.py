"""The planners: missions of ten dives against peers, with a range of depths and for the odds.

The flow of the peers' missions is a member of the quasi-geostrophic set where the shared data are there, else random eddies.
"""

from replay_kit.config.run import RunConfig
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.estimator.basis.modes import embed_member
from replay_kit.forecast import read_ensemble
from tests.benchmarks import planners_mission, planners_odds
from tests.benchmarks.measure import Row
from tests.benchmarks.planners_depth import depth_row
from tests.places import DATA
from tests.planners.flow_samples import eddying_flow

QG = DATA / "qg" / "climatology.nc"
_MEMBER = 5


def rows(tiny: bool) -> list[Row]:
    """Return what was measured."""
    return [
        depth_row(1, 110, (300.0,)) if tiny else depth_row(40),
        *planners_mission.rows(_flow(tiny), 1 if tiny else 6, tiny),
        *planners_odds.rows(tiny),
    ]


def _flow(tiny: bool) -> FlowEstimate:
    if tiny or not QG.exists():
        return eddying_flow(1 if tiny else _MEMBER, speed=0.25)
    config = RunConfig()
    return embed_member(read_ensemble(QG, config.forecast), _MEMBER, config.estimator)
