"""What a replay would use, and about how much memory and time, without writing anything."""

import time
from dataclasses import asdict, dataclass
from typing import Any

from rich.console import Console
from threadpoolctl import threadpool_limits

from replay_kit.config.run import RunConfig
from replay_kit.core.errors import ConfigError
from replay_kit.workflows.replay.checks import check_inputs
from replay_kit.workflows.replay.inputs.estimator import build
from replay_kit.workflows.replay.inputs.job import ReplayJob
from replay_kit.workflows.replay.stages.planner import PlannerFactory

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
