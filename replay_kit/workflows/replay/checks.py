"""The checks of a replay's inputs, made without an estimate: what would end the replay ends this.

They are the replay itself with an estimator that screens its measurements and estimates nothing; ``info``, ``replay --dry-run`` and ``fleet
--dry-run`` make them here.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from replay_kit.config.run import RunConfig
from replay_kit.core.arrays import Array
from replay_kit.core.observation import Measurement, Profiles, usable
from replay_kit.core.progress import silent
from replay_kit.core.region import inside
from replay_kit.estimator import Estimator, ReducedBasisEstimator
from replay_kit.estimator.interface import Stepped
from replay_kit.estimator.update.screening import Screened, columns_of, screened
from replay_kit.workflows.replay.conclude import useless_of
from replay_kit.workflows.replay.inputs.forecast import OWN, Forecasts
from replay_kit.workflows.replay.inputs.job import ReplayJob, forecasts_of
from replay_kit.workflows.replay.prepare import prepare
from replay_kit.workflows.replay.stages.planner import PlannerFactory


@dataclass(frozen=True, slots=True, eq=False)
class CheckedInputs:
    """Inputs that a replay can use.

    Attributes:
        forecasts: The part of the forecast that it would read.
        profiles: Number of profiles that the logs give.
        used: Number of those with a usable bin in the region.
        first: The first of these, as many as an estimate takes up together.
    """

    forecasts: Forecasts
    profiles: int
    used: int
    first: tuple[Profiles, ...]


def check_inputs(
    job: ReplayJob, config: RunConfig, planner_of: PlannerFactory | None = None
) -> CheckedInputs:
    """Return what a replay would use; the logs are read to their end.

    Args:
        job: The replay.
        config: Its settings.
        planner_of: Makes the planner, when the job has a goal; None leaves the goal unchecked.

    Raises:
        ReplayKitError: As the replay itself would, for inputs that it would refuse.
    """
    forecasts = forecasts_of(job, config)
    screen = (_Screen if config.estimator.name == OWN else _OfProfiles)(forecasts)
    job = replace(job, out=None, truth=None)
    run, inputs = prepare(job, config, planner_of, silent, forecasts, screen)
    run.follow_up = lambda run, steps: None
    inputs.play(run)
    useless_of(run, inputs)
    return CheckedInputs(forecasts, screen.profiles, screen.used, tuple(screen.first))


class _Screen(Estimator[None]):
    """Says what of the measurements would be used, and keeps the first profiles: mutable, as measurements come."""

    supports_path_means = True
    block_size = ReducedBasisEstimator.block_size

    def __init__(self, forecasts: Forecasts) -> None:
        self._forecasts = forecasts
        self.profiles, self.used, self.first = 0, 0, list[Profiles]()

    def initial(self) -> None:
        """Return the only state."""

    def assimilate(
        self, state: None, block: Sequence[Measurement]
    ) -> tuple[None, list[Stepped[None]]]:
        """Return what would be used."""
        grid, found = self._forecasts.ensemble.grid, list[Stepped[None]]()
        for event in block:
            ((one,), _) = screened([event], grid, relative=self.supports_path_means)
            accepted = one.is_used or _in_later_window(one, self._forecasts)
            found.append(Stepped(event, None, None, replace(one.unused(0), accepted=accepted)))
            if isinstance(event, Profiles):
                self.profiles, self.used = self.profiles + 1, self.used + accepted
                if accepted and len(self.first) < self.block_size:
                    self.first.append(event)
        return None, found

    def innovation(self, state: None, event: Measurement) -> Array:
        """Return nothing that is known, shape (n, 2)."""
        return np.full((len(columns_of(event)["flags"][0]), 2), np.nan)

    def flow(self, state: None) -> Any:
        """Return nothing: no estimate is made."""


class _OfProfiles(_Screen):
    """Of an estimator that takes profiles alone."""

    supports_path_means = False


def _in_later_window(one: Screened, forecasts: Forecasts) -> bool:
    """Return whether a measurement lies in a window that is read when the vehicle comes to it."""
    region, place = forecasts.region, tuple(one.columns[n][-1] for n in ("longitude", "latitude"))
    if one.linear is not None:
        place = one.linear.longitude[-1], one.linear.latitude[-1]
    if (
        region is None
        or not region.follows
        or inside(region.region, *place)
        or not inside(region.bounds, *place)
    ):
        return False
    in_reach = one.columns["depth"] <= forecasts.ensemble.grid.levels[-1]
    return not one.at_one_place or bool(np.any(usable(one.columns["flags"]) & in_reach))
