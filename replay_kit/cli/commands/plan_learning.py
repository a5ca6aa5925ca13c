"""``plan --objective learn`` and ``map``."""

from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING

from replay_kit.cli.commands.plan_options import Aim, Learning, Method, Outputs, Places, Times
from replay_kit.cli.console import console_beside, progress, write_json, write_text
from replay_kit.cli.options import numbers, place
from replay_kit.config.run import RunConfig
from replay_kit.core.errors import ConfigError
from replay_kit.core.paths import check_inputs

if TYPE_CHECKING:
    from replay_kit.core.plan import Place
    from replay_kit.workflows.planning.learning_request import LearnJob

Asked = tuple[Places, Times, Aim, Method, Outputs]


def plan_learning(flows: tuple[Path, ...], asked: Asked, config: RunConfig) -> int:
    """Return 0: a plan that is of no use is a result.

    Args:
        flows: The estimate.
        asked: The command's options.
        config: All settings, the command's laid over them.

    Raises:
        ConfigError: Options do not go together.
    """
    outputs = asked[-1]
    _refuse(asked)
    job = _job(flows, asked, config)
    check_inputs([*job.flows, *job.others, job.no_go, job.bathymetry])

    # what takes long to load, after what is quickly refused
    from replay_kit.workflows.planning.learning import make_learning

    with progress():
        learnt = make_learning(job, config.planner)

    from replay_kit.workflows.planning.learning_outputs import (
        learning_csv,
        learning_geojson,
        learning_json,
        print_learning,
        write_learning,
    )

    try:
        write_json(outputs.json_file, learning_json(learnt))
        if outputs.geojson is not None:
            write_text(outputs.geojson, learning_geojson(learnt))
        if outputs.csv is not None:
            write_text(outputs.csv, learning_csv(learnt))
        if outputs.out is not None:
            write_learning(outputs.out, outputs.overwrite, learnt, job, _given(asked), config)
    finally:
        print_learning(learnt, console_beside(outputs.geojson, outputs.csv, outputs.json_file))
    return 0


def refuse_learning(goal: list[str] | None, asked: Learning) -> None:
    """Raise ConfigError for options of plans that learn without their objective, and where there is no goal."""
    if any(getattr(asked, one.name) != one.default for one in fields(Learning)):
        raise ConfigError(
            "--then, --blind, --survey, --box, --profiles, --profile-error, --others: expected --objective learn or map"
        )
    if not goal:
        raise ConfigError(
            "--goal: expected LON,LAT,DEPTH, where to go; only --objective learn with --then and --objective map have none"
        )


def _refuse(asked: Asked) -> None:
    """Raise ConfigError for options that only missions have."""
    places, times, aim, method, outputs = asked
    given = {
        "--goal": places.goal or None,
        "--depart": times.depart,
        "--horizon": times.horizon,
        "--mooring": aim.mooring,
        "--line": aim.line or None,
        "--risk": method.risk,
        "--time-limit": method.time_limit,
        "--battery": method.battery,
        "--waypoints": outputs.waypoints,
    }
    names = [name for name, value in given.items() if value is not None]
    if names:
        raise ConfigError(
            f"{', '.join(names)}: expected a mission, got --objective {aim.objective}; leave {'it' if len(names) == 1 else 'them'} out"
        )


def _job(flows: tuple[Path, ...], asked: Asked, config: RunConfig) -> "LearnJob":
    """Return what is asked for, checked."""
    from replay_kit.workflows.planning.learning_request import LearnJob
    from replay_kit.workflows.planning.request import start_time_of

    places, times, aim, method, _ = asked
    job = LearnJob(
        "map" if aim.objective == "map" else "learn",
        flows,
        place(places.start, "--start"),
        () if aim.then is None else _places(aim.then),
        aim.blind,
        aim.survey,
        None if aim.box is None else _box(aim.box),
        aim.profiles,
        aim.profile_error,
        tuple(aim.others or ()),
        places.no_go,
        places.bathymetry or config.planner.bathymetry_path,
        None if times.start_time is None else start_time_of(times.start_time),
        method.arrive,
    )
    job.check()
    return job


def _places(text: str) -> tuple["Place", ...]:
    """Return the places of ``--then``, three numbers each."""
    values = numbers(text, "--then")
    if len(values) % 3:
        raise ConfigError(
            f"--then: expected LON,LAT,DEPTH[,LON,LAT,DEPTH...], got '{text}': {len(values)} numbers are no whole places"
        )
    return tuple(
        place(",".join(repr(one) for one in values[k : k + 3]), "--then")
        for k in range(0, len(values), 3)
    )


def _box(text: str) -> tuple[float, ...]:
    """Return the numbers of ``--box``."""
    values = numbers(text, "--box")
    if len(values) < 4:
        raise ConfigError(f"--box: expected W,S,E,N[,DEPTHS], got '{text}': {len(values)} numbers")
    return values


def _given(asked: Asked) -> dict[str, object]:
    """Return what was asked for beyond the configuration, as it was given."""
    places, times, aim, method, _ = asked
    return {
        "start": places.start,
        "objective": aim.objective,
        "then": aim.then,
        "blind": aim.blind,
        "survey": aim.survey,
        "box": aim.box,
        "profiles": aim.profiles,
        "profile_error": aim.profile_error,
        "start_time": times.start_time,
        "arrive": method.arrive,
    }
