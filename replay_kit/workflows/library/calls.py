"""Python interface to replay and plan, each a single call."""

# keeps the signatures in help() short: the names of types, not what they stand for
from __future__ import annotations

import builtins
import html
import shutil
import tempfile
import warnings
import weakref
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import monotonic
from typing import Any, TypedDict, Unpack

from threadpoolctl import threadpool_limits

from replay_kit.config.planner import PlannerConfig
from replay_kit.config.run import RunConfig, load_config
from replay_kit.core.as_flown import AsFlown
from replay_kit.core.errors import ConfigError, ReplayKitError, finding_text
from replay_kit.core.files.paths import (
    Paths,
    addresses_in,
    as_groups,
    as_path,
    as_paths,
    check_paths,
)
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.grid import Ensemble
from replay_kit.core.message import LogReader
from replay_kit.core.observation import Observation, PathMean
from replay_kit.core.plan import Place, Plan
from replay_kit.core.words.progress import Progress, silent
from replay_kit.core.words.quantities import to_time_ns
from replay_kit.estimator import Estimator
from replay_kit.forecast import read_ensemble
from replay_kit.forecast.names import MEMBER_NAMES
from replay_kit.show.notebook import Result, as_pooled
from replay_kit.workflows.library.parts import (
    EstimatorBuilder,
    given_estimator,
    is_forecast,
    is_observed,
    planner_factory,
    write_forecast,
    write_observed,
)
from replay_kit.workflows.planning.adapters import planner_of
from replay_kit.workflows.planning.currents import KnownCurrent
from replay_kit.workflows.replay.inputs.job import ReplayJob, Vehicle
from replay_kit.workflows.replay.inputs.planner import Planner, PlannerFactory, PlanQuery
from replay_kit.workflows.replay.replay import replay as replay_job

#: Settings of a run: tables of keys as in TOML, a TOML file, or a whole configuration; None for the defaults.
Settings = Mapping[str, Any] | str | Path | RunConfig | None
#: A path, an open log, or several; measurements or a table of them.
Logs = (
    Any
    | str
    | Path
    | LogReader
    | Observation
    | PathMean
    | Sequence[str | Path | LogReader | Observation | PathMean]
    | Mapping[str, Any]
)
#: Paths of an ensemble, or what holds its values.
Forecast = Paths | Ensemble | Any
# s between two updates of a bar
_REDRAWN = 0.2
_PARTS = ("estimator", "planner")
#: A place, or longitude, latitude [degrees] and depth [m].
At = Place | tuple[float, float, float]


class ReplayOptions(TypedDict, total=False):
    """Keyword options of ``replay``.

    Attributes:
        overwrite: Whether an existing result is replaced.
        estimator: An ``Estimator``, or a function of the ``Ensemble`` and ``EstimatorConfig`` that returns one.
        planner: A ``Planner``, or a function of the ``PlannerConfig`` and the ``Grid`` that returns one.
    """

    overwrite: bool
    estimator: EstimatorBuilder | Estimator[Any] | None
    planner: PlannerFactory | Planner | None


def replay(
    logs: Logs,
    ensemble: Forecast,
    *,
    goal: At | Mapping[str, At] | None = None,
    out: str | Path | None = None,
    settings: Settings = None,
    **options: Unpack[ReplayOptions],
) -> Result:
    """Estimate the current from logs and an ensemble forecast.

    Args:
        logs: Logs of one mission; an open log is read again from its path with these settings. Or observations (``Observation.profile``,
            ``Observation.mean``), one or several, or a table with one row per depth: a pandas table, an xarray ``Dataset`` or a mapping
            convertible to one, with ``time``, ``longitude``, ``latitude``, ``depth`` [m], ``u``, ``v`` and ``error``
            [m/s]; ``logs.columns`` names others. They are saved next to ``out`` as NAME.observations.mcap. For several vehicles that share
            the estimate, a mapping of names to logs.
        ensemble: NetCDF files, Zarr stores, folders or patterns; ``forecast.members`` defines a member. With ``models``, each inner list of
            files is one product. Or an ``Ensemble``, an xarray ``Dataset`` or a mapping convertible to one, saved next to ``out`` as
            NAME.ensemble.nc; in a list each is a member.
        goal: Goal of the vehicle or of all vehicles, or a mapping of names to goals; None plans nothing.
        out: Result MCAP; None for a temporary file, which exists as long as the value returned.
        settings: Settings such as ``{"forecast": {"levels": [5, 150, 500]}}``; for all see ``replay_kit.RunConfig``.
        **options: ``overwrite=True`` replaces an existing result. ``estimator=`` and ``planner=`` replace those of the
            settings: see ``ReplayOptions``.

    Raises:
        ReplayKitError: An input cannot be used, or a setting is wrong.
    """
    if unknown := options.keys() - ReplayOptions.__annotations__.keys():
        known = ", ".join(ReplayOptions.__annotations__)
        raise ConfigError(
            f"replay: expected options among {known}, got {', '.join(sorted(unknown))}"
        )
    config, overwrite = settings_of(settings), options.get("overwrite", False)
    estimator = options.get("estimator")
    of_each = logs if isinstance(logs, Mapping) and not is_observed(logs) else None
    if goal is not None and any(map(is_observed, [logs] if of_each is None else of_each.values())):
        raise ConfigError(
            "goal: the table has no vehicle position; plan on the estimate: plan(result.estimate, start, goal)"
        )
    folder = Path(tempfile.mkdtemp(prefix="replay_kit_")) if out is None else None
    held = Held(
        as_path(out, "out") if folder is None else folder / "result.mcap", overwrite, config
    )
    file = held.out
    config = _with_members(config, ensemble)
    try:
        vehicles = () if of_each is None else _vehicles(of_each, goal, held)
        of_one = None
        if goal is not None and not isinstance(goal, Mapping):
            of_one = place_of(goal, "goal")
        job = ReplayJob(
            tuple(path for one in vehicles for path in one.logs) or held.log_paths(logs),
            held.forecast_paths(ensemble),
            file,
            goal=of_one,
            vehicles=vehicles,
            overwrite=overwrite,
            estimator=None if estimator is None else given_estimator(estimator),
            provided=tuple(name for name in _PARTS if options.get(name) is not None),
        )
        if addresses_in(job.ensemble):
            # loads a client of servers
            from replay_kit.workflows.fetch import with_local_forecast

            job = with_local_forecast(job, config)
        with _notebook_progress() as progress:
            outcome, flow = replay_job(
                job, config, planner_factory(options.get("planner")), progress
            )
    except BaseException as error:
        if folder is not None:
            shutil.rmtree(folder)
        held.name(error)
        raise
    if 4 in outcome.exit_codes:
        lost = (
            f"lost: {len(outcome.losses)} damaged parts of the logs, {outcome.late} late messages"
        )
        unused = [f"{name}: {why}" for name, why in outcome.unused.items()]
        warnings.warn("; ".join(unused) or lost, stacklevel=2)
    if 6 in outcome.exit_codes:
        warnings.warn("; ".join(map(finding_text, outcome.consistency)), stacklevel=2)
    result = as_pooled(Result(file, outcome))
    # the estimate is at hand, and need not be read back
    vars(result)["estimate"] = flow
    if folder is not None:
        weakref.finalize(result, shutil.rmtree, folder, ignore_errors=True)
    return result


@contextmanager
def _notebook_progress() -> Iterator[Progress]:
    """Show progress in a notebook cell until the work is done; nothing elsewhere."""
    shell = getattr(builtins, "get_ipython", lambda: None)()
    if type(shell).__name__ != "ZMQInteractiveShell":
        yield silent
        return
    from IPython.display import HTML, display

    bar: Any = display(HTML("<progress></progress>"), display_id=True)
    due = 0.0

    def show(done: float, total: float, what: str) -> None:
        nonlocal due
        if (now := monotonic()) >= due:
            due = now + _REDRAWN
            share = f"value={done / total:.3f}" if total else ""
            bar.update(HTML(f"<progress {share}></progress> {html.escape(what)}"))

    try:
        yield show
    finally:
        bar.update(HTML(""))


@dataclass(frozen=True)
class Held:
    """In-memory inputs, saved as files next to a result.

    Attributes:
        out: The result.
        overwrite: Whether existing files are replaced.
        config: Settings of the run.
        names: Name of each file in errors.
    """

    out: Path
    overwrite: bool
    config: RunConfig
    names: dict[Path, str] = field(default_factory=dict)

    def path(self, ending: str, name: str) -> Path:
        """Return the file for an input."""
        path = self.out.with_suffix(ending)
        check_paths((), (path,), self.overwrite)
        self.names[path] = name
        return path

    def named(self, words: str) -> str:
        """Return an error message with the names of inputs in place of their files."""
        for path, name in self.names.items():
            words = words.replace(str(path), name).replace(path.name, name)
        return words

    def name(self, error: BaseException) -> None:
        """Rename the files of inputs in an error about them."""
        if isinstance(error, ReplayKitError):
            error.args = tuple(self.named(str(words)) for words in error.args)

    def log_paths(self, logs: Logs, vehicle: str = "") -> tuple[Path, ...]:
        """Return the logs of a replay or one of its vehicles; observations and tables are written to files."""
        if is_observed(logs):
            name = f"logs['{vehicle}']" if vehicle else "measurements"
            path = self.path(f"{vehicle and '.'}{vehicle}.observations.mcap", name)
            write_observed(path, logs, name, self.config.logs.columns)
            return (path,)
        each = logs if isinstance(logs, list | tuple) else [logs]
        if not each:
            raise ConfigError("logs: expected one log or several, got none")
        return tuple(as_path(getattr(log, "path", log), "log") for log in each)

    def forecast_paths(self, ensemble: Forecast) -> tuple[tuple[Path, ...], ...]:
        """Return the files of a forecast; datasets are written, each to its own file."""
        several = isinstance(ensemble, list | tuple)
        each: Sequence[Any] = ensemble if isinstance(ensemble, list | tuple) else [ensemble]
        if not any(map(is_forecast, each)):
            return as_groups(ensemble, "ensemble")
        groups: list[tuple[Path, ...]] = []
        for k, forecast in enumerate(each):
            if not is_forecast(forecast):
                groups.append(as_paths(forecast, "ensemble"))
                continue
            name = f"ensemble[{k}]" if several else "ensemble"
            path = self.path(f".{name.replace('[', '.').rstrip(']')}.nc", name)
            write_forecast(path, forecast, name)
            groups.append((path,))
        return tuple(groups)


def _with_members(config: RunConfig, ensemble: Any) -> RunConfig:
    """Return settings in which listed datasets are members, unless the settings differ or a dataset has members itself."""
    several = isinstance(ensemble, list | tuple) and all(hasattr(one, "dims") for one in ensemble)
    if (
        not several
        or config.forecast.members
        or any({*MEMBER_NAMES} & {*one.dims} for one in ensemble)
    ):
        return config
    forecast = config.forecast.model_copy(update={"members": "files"})
    return config.model_copy(update={"forecast": forecast})


def _vehicles(logs: Mapping[str, Any], goal: Any, held: Held) -> tuple[Vehicle, ...]:
    """Return the vehicles of a replay, each with its logs and goal."""
    goals: Mapping[str, Any] = goal if isinstance(goal, Mapping) else {}
    if not logs or (unknown := [name for name in goals if name not in logs]):
        what = f"goal: {', '.join(unknown)}" if logs else "logs"
        raise ConfigError(f"{what}: expected names of vehicles among {', '.join(logs) or 'none'}")
    return tuple(
        Vehicle(
            str(name),
            held.log_paths(of_vehicle, str(name)),
            None if goals.get(name) is None else place_of(goals[name], f"goal of {name}"),
        )
        for name, of_vehicle in logs.items()
    )


def plan(
    estimate: FlowEstimate, start: At, goal: At, *, time: Any = None, settings: Settings = None
) -> Plan:
    """Return the best mission found on an estimate, with its odds, or glide if ``planner.kind`` is ``glide``.

    Args:
        estimate: The current.
        start: Start position.
        goal: Goal.
        time: Start time: ISO 8601 text, datetime64 or integer nanoseconds (UTC); None for the estimate's time.
        settings: See ``replay``; ``[planner]`` and ``output.threads`` apply.

    Raises:
        PlanError: Start or goal is outside the region or on land, or the time outside the forecast.
    """
    if not isinstance(estimate, FlowEstimate):
        got = type(estimate).__name__
        raise ConfigError(
            f"estimate: expected a FlowEstimate, got {got}; open one with open_estimate, or take that of a result"
        )
    config = settings_of(settings)
    start_ns = (estimate.time_ns or 0) if time is None else int(to_time_ns(time))
    query = PlanQuery(place_of(start, "start"), place_of(goal, "goal"), start_ns)
    with threadpool_limits(limits=config.output.threads):
        return planned(estimate, query, config.planner.resolved(of_glider=True), None)


def planned(
    estimate: FlowEstimate, query: PlanQuery, config: PlannerConfig, flown: AsFlown | None
) -> Plan:
    """Return the best plan found on an estimate, with its odds.

    Args:
        estimate: The current.
        query: Start, goal and time.
        config: ``[planner]``.
        flown: Flight parameters of the dives so far; None without any.

    Raises:
        PlanError: Start or goal is outside the region or on land, or the time outside the forecast.
    """
    planner = planner_of(config, estimate.grid)
    planner.check(estimate, query.goal)
    KnownCurrent((estimate,), config.flow_step).check_time("time", query.start_time_ns)
    known = planner if flown is None else planner.as_flown(flown)
    return known.with_odds().plan(estimate, query).plan


def open_ensemble(ensemble: Forecast, *, settings: Settings = None) -> Ensemble:
    """Return the members of an ensemble forecast that a replay would use.

    Args:
        ensemble: See ``replay``.
        settings: See ``replay``; only ``[forecast]`` applies.

    Raises:
        ForecastError: A file is missing or is not an ensemble.
    """
    with forecast_files(ensemble, settings_of(settings)) as held:
        paths = [path for group in held.forecast_paths(ensemble) for path in group]
        # what is not in memory is a path, a list or a pattern, whose words errors repeat
        asked: Any = paths if held.names else ensemble
        found = read_ensemble(asked, held.config.forecast)
        return replace(found, source=held.named(found.source))


@contextmanager
def forecast_files(ensemble: Forecast, config: RunConfig) -> Iterator[Held]:
    """Yield the settings of a forecast, and a place for its files while they are read; errors name it as the caller does."""
    with tempfile.TemporaryDirectory(prefix="replay_kit_") as folder:
        file = Path(folder) / "result.mcap"
        held = Held(file, overwrite=False, config=_with_members(config, ensemble))
        try:
            yield held
        except ReplayKitError as error:
            held.name(error)
            raise


def settings_of(settings: Settings) -> RunConfig:
    """Return the complete configuration of settings.

    Raises:
        ConfigError: A key or value is wrong, or the file is missing.
    """
    if isinstance(settings, RunConfig):
        return settings
    if isinstance(settings, Mapping):
        return load_config(None, settings)
    return load_config(None if settings is None else as_path(settings, "settings"))


def place_of(at: At, what: str) -> Place:
    """Return the position of a value.

    Args:
        at: Position, or its three numbers.
        what: Its name in the error.

    Raises:
        ConfigError: The value is neither.
    """
    if isinstance(at, Place):
        return at
    try:
        longitude, latitude, depth = (float(number) for number in at)
    except (TypeError, ValueError) as error:
        raise ConfigError(
            f"{what}: expected longitude, latitude [degrees] and depth [m], got {at!r}"
        ) from error
    return Place(longitude, latitude, depth)
