"""Assignment of logs to vehicles: by the user's names, by the missions stated in the logs, or by their tracks."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from replay_kit.config.run import RunConfig
from replay_kit.core.errors import ConfigError, MeasurementError
from replay_kit.core.region import Region, bounds_of, inside
from replay_kit.core.words.text import some_text, time_text
from replay_kit.logs.opening import in_folder, logs_in
from replay_kit.results.reader import RESERVED
from replay_kit.workflows.replay.inputs.forecast import Forecasts
from replay_kit.workflows.replay.inputs.job import ReplayJob, Vehicle
from replay_kit.workflows.replay.inputs.provenance import input_hash
from replay_kit.workflows.replay.inputs.scan import Logs, open_readers

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*")
# What follows a vehicle's name in that of a mission: its number, or a date.
_OF_MISSION = re.compile(r"([ _-]+mission\b.*|[ _.-]+\d{8}.*|\.\d+)$", re.IGNORECASE)
_HOUR_NS, _YEAR_NS = 3600 * 10**9, 366 * 86_400 * 10**9
# Two spans that are apart by the same time at both ends, to so much, may be one by a wrong clock [ns].
_SAME_NS = _HOUR_NS // 6
_SHOWN = 50


def identified(job: ReplayJob, config: RunConfig) -> ReplayJob:
    """Return a job with its vehicles in order of name, those without a position excluded; unchanged for a single vehicle.

    Args:
        job: Job with named vehicles, or with logs that may state theirs.
        config: The run's settings.

    Raises:
        ConfigError: A name is invalid or has no log, a log is given twice, or an option needs a single vehicle.
        MeasurementError: No vehicle has a position, or the vehicles are more than a year apart.
        LogError: A log cannot be opened.
    """
    vehicles = job.vehicles or _by_missions(job.logs, config)
    if all(one.places or one.why_not for one in vehicles):
        return job
    for name in (one.name for one in vehicles):
        if not _NAME.fullmatch(name) or name in RESERVED:
            raise ConfigError(
                f"vehicle '{name}': expected a name of letters, digits and _.-, none of {', '.join(RESERVED)}; choose another"
            )
    _check_contents(vehicles)
    if config.time.biases or job.against:
        what = "--against" if job.against else "time.biases"
        raise ConfigError(
            f"{what}: expected the logs of one vehicle, got those of {len(vehicles)}; omit it, or replay each separately"
        )
    placed = _placed([_in_order(one) for one in sorted(vehicles, key=lambda one: one.name)], config)
    given = tuple(replace(one, goal=one.goal or job.goal) for one in placed)
    logs = tuple(path for one in given if not one.why_not for path in one.logs)
    return replace(job, vehicles=given, logs=logs, goal=None)


def _in_order(vehicle: Vehicle) -> Vehicle:
    """Return a vehicle with its logs in the order of a folder with them, then of content, however given."""
    if len(vehicle.logs) < 2:
        return vehicle
    logs = sorted(vehicle.logs, key=lambda path: (in_folder(path), input_hash(path)))
    return replace(vehicle, logs=tuple(logs))


def _check_contents(vehicles: Sequence[Vehicle]) -> None:
    """Raise ConfigError if a log is given under two names."""
    held: dict[str, tuple[str, Path]] = {}
    for one in vehicles:
        for path in (file for log in one.logs for file in logs_in(log)):
            name, other = held.setdefault(input_hash(path), (one.name, path))
            if name != one.name:
                raise ConfigError(
                    f"{path} of {one.name}: identical to {other} of {name}; a log is of one vehicle: leave one of them out"
                )


def _by_missions(logs: Sequence[Path], config: RunConfig) -> tuple[Vehicle, ...]:
    """Return the vehicles stated by logs; empty for fewer than two.

    Raises:
        ConfigError: Some logs do not state their vehicle, although others state several.
    """
    if len(logs) < 2:
        return ()
    stated = {path: _stated(path, config) for path in logs}
    names = sorted({name for name in stated.values() if name})
    if len(names) < 2:
        return ()
    if unknown := [path.name for path, name in stated.items() if not name]:
        raise ConfigError(
            f"{some_text(unknown)}: the logs are of {some_text(names)}, and this one does not state its vehicle; name "
            f"it with --as {names[0]}={unknown[0]}, and name the logs of the others too"
        )
    return tuple(
        Vehicle(name, tuple(path for path in logs if stated[path] == name)) for name in names
    )


def _stated(path: Path, config: RunConfig) -> str:
    """Return the vehicle name stated by a log or a folder of logs; empty for none or several."""
    missions = [log.mission for log in open_readers([path], config)]
    names = {_OF_MISSION.sub("", mission) for mission in missions if mission}
    return re.sub(r"[^A-Za-z0-9_.-]+", "_", names.pop()) if len(names) == 1 else ""


def _placed(vehicles: Sequence[Vehicle], config: RunConfig) -> list[Vehicle]:
    """Return vehicles with some of their places and notes on their times; those without a place are excluded.

    Raises:
        MeasurementError: No vehicle has a place, or the vehicles are more than a year apart.
    """
    found, spans = list[Vehicle](), dict[str, tuple[int, int]]()
    for one in vehicles:
        if one.why_not:
            found.append(one)
            continue
        reach = Logs([one.logs], config).reach
        if not len(reach.places) or reach.first_ns is None or reach.last_ns is None:
            why = "no position in its logs, so it is not used; the others are replayed"
            found.append(replace(one, why_not=why))
            continue
        spans[one.name] = reach.first_ns, reach.last_ns
        step = max(1, len(reach.places) // _SHOWN)
        places = tuple((float(east), float(north)) for east, north in reach.places[::step])
        found.append(replace(one, places=places))
    if not spans:
        raise MeasurementError(
            f"{some_text([one.name for one in vehicles])}: expected positions, no vehicle's logs hold any"
        )
    return [replace(one, notes=_of_times(one.name, spans)) for one in found]


def _of_times(name: str, spans: Mapping[str, tuple[int, int]]) -> tuple[str, ...]:
    """Return notes on a vehicle's times compared with those of the others.

    Raises:
        MeasurementError: They are more than a year apart.
    """
    others = [span for other, span in spans.items() if other != name]
    if name not in spans or not others:
        return ()
    first_ns, last_ns = spans[name]
    # that of most vehicles must not be blamed for the times of one
    begin_ns, end_ns = min(others, key=lambda span: (abs(span[0] - first_ns), span))
    if abs(first_ns - begin_ns) > _YEAR_NS:
        raise MeasurementError(
            f"{name}: begins at {time_text(first_ns)}, the nearest of the others at {time_text(begin_ns)}: measurements of different "
            "years do not share an estimate; replay it separately, or correct its clock"
        )
    later, ends_later = first_ns - begin_ns, last_ns - end_ns
    if abs(later) >= _HOUR_NS and abs(later - ends_later) <= _SAME_NS:
        return (
            f"its messages begin and end {abs(later) / _HOUR_NS:.1f} h {'after' if later > 0 else 'before'} those of any other vehicle: "
            "if they flew at the same time, a clock is wrong",
        )
    if all(first_ns > span[1] or last_ns < span[0] for span in others):
        return ("its logs have no time in common with those of the others",)
    return ()


def first_windows(job: ReplayJob, forecasts: Forecasts) -> dict[str, Region]:
    """Return the first window of each of several vehicles by name; empty if one window holds all.

    Raises:
        MeasurementError: A vehicle was never in the region of the others.
    """
    region, found = forecasts.region, dict[str, Region]()
    follows = region if region is not None and region.follows else None
    box = bounds_of(forecasts.ensemble.grid) if follows is None else follows.bounds
    for one in job.vehicles:
        held = [place for place in one.places if inside(box, *place)]
        if held and follows is not None:
            found[one.name] = follows.about(held[0])
        elif one.places and not held:
            longitude, latitude = one.places[-1]
            anew = ", or delete the folder of states: the first logs chose the region"
            raise MeasurementError(
                f"{one.name}: was at {latitude:.2f} N, {longitude:.2f} E, outside the region of the forecast, so it "
                f"cannot share the estimate; replay it separately, with a forecast of its place{anew if job.following else ''}"
            )
    return found
