"""Checks of a replay's inputs without an estimate; they raise the errors of the replay.

They are the replay itself with an estimator that only screens observations; used by ``info``, ``replay --dry-run`` and ``fleet --dry-run``.
A dry run also estimates memory and time of a replay.
"""

import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from replay_kit.config.run import RunConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import ConfigError, Finding
from replay_kit.core.message import Message
from replay_kit.core.observation import Measurement, Profiles, usable
from replay_kit.core.region import inside
from replay_kit.core.words.progress import silent
from replay_kit.estimator import Estimator, ReducedBasisEstimator
from replay_kit.estimator.interface import Stepped
from replay_kit.estimator.update.screening import Screened, columns_of, screened
from replay_kit.workflows.replay.conclude import useless_of
from replay_kit.workflows.replay.inputs.forecast import OWN, Forecasts, build
from replay_kit.workflows.replay.inputs.job import ReplayJob, forecasts_of, logs_of
from replay_kit.workflows.replay.inputs.planner import PlannerFactory
from replay_kit.workflows.replay.inputs.prepare import prepare


def _ignore(*_: Any) -> None: ...


def check_inputs(
    job: ReplayJob,
    config: RunConfig,
    planner_of: PlannerFactory | None = None,
    on_message: Callable[[Message], None] = _ignore,
    on_profile: Callable[[Profiles, bool], None] = _ignore,
) -> tuple[Forecasts, tuple[Finding, ...]]:
    """Return the part of the forecast that a replay reads, and contradictions within the first vehicle's logs; reads all logs.

    Args:
        job: The replay.
        config: Settings of the replay.
        planner_of: Factory of the planner for a job with a goal; None leaves the goal unchecked.
        on_message: Called with each message, before the profiles that it completes.
        on_profile: Called with each profile after the checks, and whether it has a usable bin in the region.

    Raises:
        ReplayKitError: The replay would refuse the inputs.
    """
    logs = logs_of(job, config)
    forecasts = forecasts_of(job, config, logs)
    screen = (_Screen if config.estimator.name == OWN else _OfProfiles)(forecasts, on_profile)
    job = replace(job, out=None, truth=None)
    run, inputs = prepare(job, config, planner_of, silent, forecasts, screen, logs)

    def messages() -> Iterator[Message]:
        for message in inputs.messages():
            on_message(message)
            yield message

    deque(inputs.played(run, messages()), 0)
    useless_of(run, inputs)
    return forecasts, run.of[0].monitoring.findings


class _Screen(Estimator[None]):
    """Estimator that only screens observations."""

    supports_path_means = True
    block_size = ReducedBasisEstimator.block_size

    def __init__(self, forecasts: Forecasts, on_profile: Callable[[Profiles, bool], None]) -> None:
        self._forecasts, self._on_profile = forecasts, on_profile

    def initial(self) -> None:
        """Return the only state, None."""

    def assimilate(
        self, state: None, block: Sequence[Measurement]
    ) -> tuple[None, list[Stepped[None]]]:
        """Return the screened observations."""
        grid, found = self._forecasts.ensemble.grid, list[Stepped[None]]()
        for event in block:
            ((one,), _) = screened([event], grid, relative=self.supports_path_means)
            accepted = one.is_used or _in_later_window(one, self._forecasts)
            found.append(Stepped(event, None, None, replace(one.unused(0), accepted=accepted)))
            if isinstance(event, Profiles):
                self._on_profile(event, accepted)
        return None, found

    def innovation(self, state: None, event: Measurement) -> Array:
        """Return an unknown innovation, shape (n, 2)."""
        return np.full((len(columns_of(event)["flags"][0]), 2), np.nan)

    def flow(self, state: None) -> Any:
        """Return None in place of an estimate."""


class _OfProfiles(_Screen):
    """Protocol of an estimator that accepts profiles only."""

    supports_path_means = False


def _in_later_window(one: Screened, forecasts: Forecasts) -> bool:
    """Return whether an observation lies in a window that is read once the vehicle reaches it."""
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
    """Expected inputs, memory and time of a replay.

    Attributes:
        profiles: Number of profiles in the logs.
        profiles_used: Number of profiles with a usable bin in the region.
        members: Number of ensemble members.
        grid: Number of points along the grid's two axes.
        levels: Levels used [m].
        modes: Number of modes per level.
        state_size: Number of weights in the filter's state.
        memory_mb: Expected peak memory [MB].
        seconds: Expected time of all updates [s], extrapolated from a few.
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

    def __str__(self) -> str:
        """Return the dry run as a sentence."""
        (rows, columns), levels = self.grid, self.levels
        return (
            f"Would use {self.profiles_used} of {self.profiles} profiles with {self.members} members "
            f"on {rows} x {columns} points and {len(levels)} levels ({levels[0]:g} to {levels[-1]:g} m): "
            f"{self.modes} modes a level, a state of {self.state_size} unknowns. "
            f"Expected: {self.memory_mb:.0f} MB, {self.seconds:.0f} s for the updates"
        )


def dry_run(
    job: ReplayJob,
    config: RunConfig,
    planner_of: PlannerFactory | None = None,
) -> DryRun:
    """Return the expected inputs, memory and time of a replay; reads the logs completely, with only a few updates.

    Args:
        job: The replay.
        config: Settings of the replay.
        planner_of: Factory of the planner for a job with a goal.

    Raises:
        ReplayKitError: The replay would refuse the logs or the ensemble.
    """
    if config.estimator.name != "reduced_basis":
        raise ConfigError(
            f"--dry-run describes the reduced basis, not {config.estimator.name}; leave one of the two out"
        )
    seen, some = Counter[bool](), list[Profiles]()

    def note(profile: Profiles, used: bool) -> None:
        seen[used] += 1
        if used and len(some) < ReducedBasisEstimator.block_size:
            some.append(profile)

    with threadpool_limits(limits=config.output.threads):
        forecasts, _ = check_inputs(job, config, planner_of, on_profile=note)
        ensemble = forecasts.ensemble
        # Any: a baseline was refused above, and the two that are left have what is asked for here
        estimator: Any = build(forecasts, config)
        timed = list(filter(estimator.usable, some))
        began = time.perf_counter()
        if timed:
            estimator.assimilate(estimator.initial(), timed)
        spent = time.perf_counter() - began
    size = estimator.unknowns
    return DryRun(
        profiles=seen.total(),
        profiles_used=seen[True],
        members=ensemble.n_members,
        grid=(ensemble.grid.east.shape[0], ensemble.grid.east.shape[1]),
        levels=tuple(float(level) for level in ensemble.grid.levels),
        modes=estimator.flow(estimator.initial()).n_modes,
        state_size=size,
        memory_mb=_BASE_MB + _COVARIANCES * 8e-6 * size**2 + 2e-6 * ensemble.velocity.nbytes,
        seconds=seen[True] * spent / len(timed) if timed else 0.0,
    )


def dry_run_json(result: DryRun) -> dict[str, Any]:
    """Return the dry run for JSON."""
    return {"status": "dry run", "exit_code": 0, **asdict(result)}
