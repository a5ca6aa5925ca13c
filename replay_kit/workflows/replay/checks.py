"""The checks of a replay's inputs, made without an estimate: what would end the replay ends this.

They are the replay itself with an estimator that screens its measurements and estimates nothing; ``info``, ``replay --dry-run`` and ``fleet
--dry-run`` make them here. A dry run says too about how much memory and time a replay would take.
"""

import time
from collections import deque
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from rich.console import Console
from threadpoolctl import threadpool_limits

from replay_kit.config.run import RunConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import ConfigError
from replay_kit.core.observation import Measurement, Profiles, usable
from replay_kit.core.progress import silent
from replay_kit.core.region import inside
from replay_kit.estimator import Estimator, ReducedBasisEstimator
from replay_kit.estimator.interface import Stepped
from replay_kit.estimator.update.screening import Screened, columns_of, screened
from replay_kit.workflows.replay.conclude import useless_of
from replay_kit.workflows.replay.inputs.estimator import build
from replay_kit.workflows.replay.inputs.forecast import OWN, Forecasts
from replay_kit.workflows.replay.inputs.job import ReplayJob, forecasts_of, logs_of
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
    logs = logs_of(job, config)
    forecasts = forecasts_of(job, config, logs)
    screen = (_Screen if config.estimator.name == OWN else _OfProfiles)(forecasts)
    job = replace(job, out=None, truth=None)
    run, inputs = prepare(job, config, planner_of, silent, forecasts, screen, logs)
    deque(inputs.played(run), 0)
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


# What the interpreter and the libraries take before the first array.
_BASE_MB = 250.0
# The covariance before an update, after it, and the half gains' product between them, with one to spare for the output.
_COVARIANCES = 4


@dataclass(frozen=True, slots=True)
class DryRun:
    """What a replay would use.

    Attributes:
        profiles: Profiles the logs give.
        profiles_used: Those with a usable bin in the region.
        members: Ensemble members.
        grid: Points along the grid's two directions.
        levels: Levels used [m].
        modes: Basis flows a level.
        state_size: Weights in the filter's state.
        memory_mb: Memory expected at the peak.
        seconds: Time expected for all updates, from the profiles stepped through here.
    """

    profiles: int
    profiles_used: int
    members: int
    grid: tuple[int, int]
    levels: tuple[float, ...]
    modes: int
    state_size: int
    memory_mb: float
    seconds: float


def dry_run(
    job: ReplayJob,
    config: RunConfig,
    planner_of: PlannerFactory | None = None,
) -> DryRun:
    """Return what a replay would use; the logs are read to their end, but only a few updates are made.

    Args:
        job: The replay.
        config: Its settings.
        planner_of: Makes the planner, when the job has a goal.

    Raises:
        ReplayKitError: As the replay itself would, for logs and ensembles that cannot be used.
    """
    if config.estimator.name != "reduced_basis":
        raise ConfigError(
            f"--dry-run describes the reduced basis, not {config.estimator.name}; leave one of the two out"
        )
    with threadpool_limits(limits=config.output.threads):
        inputs = check_inputs(job, config, planner_of)
        ensemble = inputs.forecasts.ensemble
        # Any: a baseline was refused above, and the two that are left have what is asked for here
        estimator: Any = build(inputs.forecasts, config)
        timed = list(filter(estimator.usable, inputs.first))
        began = time.perf_counter()
        if timed:
            estimator.assimilate(estimator.initial(), timed)
        spent = time.perf_counter() - began
    size = estimator.unknowns
    return DryRun(
        profiles=inputs.profiles,
        profiles_used=inputs.used,
        members=ensemble.n_members,
        grid=(ensemble.grid.east.shape[0], ensemble.grid.east.shape[1]),
        levels=tuple(float(level) for level in ensemble.grid.levels),
        modes=estimator.flow(estimator.initial()).n_modes,
        state_size=size,
        memory_mb=_BASE_MB + _COVARIANCES * 8e-6 * size**2 + 2e-6 * ensemble.velocity.nbytes,
        seconds=inputs.used * spent / len(timed) if timed else 0.0,
    )


def dry_run_json(result: DryRun) -> dict[str, Any]:
    """Return the JSON object of ``--json``."""
    return {"status": "dry run", "exit_code": 0, **asdict(result)}


def print_dry_run(result: DryRun, console: Console) -> None:
    """Print what a replay would use, as a sentence."""
    rows, columns = result.grid
    levels = result.levels
    console.print(
        f"Would use {result.profiles_used} of {result.profiles} profiles with {result.members} members "
        f"on {rows} x {columns} points and {len(levels)} levels ({levels[0]:g} to {levels[-1]:g} m): "
        f"{result.modes} modes a level, a state of {result.state_size} unknowns. "
        f"Expected: {result.memory_mb:.0f} MB, {result.seconds:.0f} s for the updates. Nothing was written.",
    )
