"""The goal of a vehicle: what plans towards it, and whether it can be reached at all."""

from collections.abc import Sequence

import numpy as np

from replay_kit.config.run import RunConfig
from replay_kit.core.errors import PlanError
from replay_kit.core.geodesy import inside_grid, to_local
from replay_kit.core.message import LogReader
from replay_kit.logs.reader import LogFile
from replay_kit.workflows.replay.inputs.job import ReplayJob, Vehicle
from replay_kit.workflows.replay.inputs.scan import reach_of
from replay_kit.workflows.replay.stages.planner import HasGrid, Planner


def with_planner_kind(
    job: ReplayJob | Vehicle, readers: Sequence[LogReader], config: RunConfig
) -> RunConfig:
    """Return the settings with what a replay with a goal plans: for a glider's logs a mission, where no kind is chosen.

    Args:
        job: Without a goal, nothing changes.
        readers: Its opened logs.
        config: The settings.
    """
    if job.goal is None or config.planner.kind != "auto":
        return config
    gliders = any(isinstance(log, LogFile) and log.is_gliders() for log in readers)
    return config.model_copy(update={"planner": config.planner.resolved(gliders)})


def check_goal(
    planner: Planner, flow: HasGrid, job: ReplayJob | Vehicle, config: RunConfig
) -> None:
    """Raise PlanError when the goal is outside the region or on land, and say so when the whole log is outside the region too."""
    assert job.goal is not None
    try:
        planner.check(flow, job.goal)
    except PlanError as error:
        places = reach_of(job.logs, config).places
        local = to_local(flow.grid.projection, *places.T)
        if not len(places) or np.any(inside_grid(flow.grid, *local)):
            raise
        (west, south), (east, north) = places.min(axis=0), places.max(axis=0)
        raise PlanError(
            f"{error}. The whole log lies outside it too, in {west:.2f}..{east:.2f} E, {south:.2f}..{north:.2f} N: "
            "use an ensemble of that place, or --place-ensemble for a study"
        ) from error
