"""Assignment of logs to vehicles: by the user's names, by the missions stated in the logs, or by their tracks."""

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from replay_kit.config.run import RunConfig
from replay_kit.core.errors import ConfigError, LogError, MeasurementError
from replay_kit.core.region import Region, bounds_of, inside_box
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
_YEAR_NS = 366 * 86_400 * 10**9
# Places that are kept of a vehicle.
_SHOWN = 50


def with_vehicles(job: ReplayJob, config: RunConfig) -> ReplayJob:
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
    if all(vehicle.places or vehicle.why_not for vehicle in vehicles):
        return job
    held = dict[str, tuple[str, Path]]()
    for vehicle in vehicles:
        if not _NAME.fullmatch(vehicle.name) or vehicle.name in RESERVED:
            raise ConfigError(
                f"vehicle '{vehicle.name}': expected a name of letters, digits and _.-, none of {', '.join(RESERVED)}; choose another"
            )
        for path in (file for log in vehicle.logs for file in logs_in(log)):
            if not path.exists():
                raise LogError(f"{path} of {vehicle.name}: file not found; correct its name")
            name, other = held.setdefault(input_hash(path), (vehicle.name, path))
            if name != vehicle.name:
                raise ConfigError(
                    f"{path} of {vehicle.name}: identical to {other} of {name}; a log is of one vehicle: leave one of them out"
                )
    if config.time.biases or job.against:
        what = "--against" if job.against else "time.biases"
        raise ConfigError(
            f"{what}: expected the logs of one vehicle, got those of {len(vehicles)}; omit it, or replay each separately"
        )
    placed, begins = list[Vehicle](), dict[str, int]()
    for vehicle in sorted(vehicles, key=lambda vehicle: vehicle.name):
        # in the order of a folder with them, then of content, however given
        in_order = sorted(vehicle.logs, key=lambda path: (in_folder(path), input_hash(path)))
        vehicle = replace(vehicle, logs=tuple(in_order), goal=vehicle.goal or job.goal)
        if not vehicle.why_not:
            reach = Logs([vehicle.logs], config).reach
            some = reach.places[:: max(1, len(reach.places) // _SHOWN)]
            places = tuple((float(east), float(north)) for east, north in some)
            why = "no position in its logs, so it is not used"
            if places and reach.first_ns is not None:
                begins[vehicle.name], why = reach.first_ns, ""
            vehicle = replace(vehicle, places=places, why_not=why)
        placed.append(vehicle)
    if not begins:
        raise MeasurementError(
            f"{some_text([vehicle.name for vehicle in placed])}: expected positions, no vehicle's logs hold any"
        )
    for name, first_ns in begins.items():
        # that of most vehicles must not be blamed for the times of one
        others = (at for other, at in begins.items() if other != name)
        begin_ns = min(others, key=lambda at: (abs(at - first_ns), at), default=first_ns)
        if abs(first_ns - begin_ns) > _YEAR_NS:
            raise MeasurementError(
                f"{name}: begins at {time_text(first_ns)}, the nearest of the others at {time_text(begin_ns)}: measurements of different "
                "years share no estimate; replay it separately, or correct its clock"
            )
    logs = tuple(path for vehicle in placed if not vehicle.why_not for path in vehicle.logs)
    return replace(job, vehicles=tuple(placed), logs=logs, goal=None)


def _by_missions(logs: Sequence[Path], config: RunConfig) -> tuple[Vehicle, ...]:
    """Return the vehicles stated by logs or folders of logs; empty for fewer than two.

    Raises:
        ConfigError: Some logs do not state their vehicle, although others state several.
    """
    stated = dict[str, list[Path]]()
    for path in logs if len(logs) > 1 else ():
        missions = [log.mission for log in open_readers([path], config)]
        names = {_OF_MISSION.sub("", mission) for mission in missions if mission}
        name = names.pop() if len(names) == 1 else ""
        stated.setdefault(re.sub(r"[^A-Za-z0-9_.-]+", "_", name), []).append(path)
    unknown = [path.name for path in stated.pop("", ())]
    if len(stated) < 2:
        return ()
    if unknown:
        raise ConfigError(
            f"{some_text(unknown)}: the logs are of {some_text(sorted(stated))}, and this one does not state its vehicle; name "
            f"it with --as {min(stated)}={unknown[0]}, and name the logs of the others too"
        )
    return tuple(Vehicle(name, tuple(of_vehicle)) for name, of_vehicle in sorted(stated.items()))


def first_windows(job: ReplayJob, forecasts: Forecasts) -> dict[str, Region]:
    """Return the first window of each of several vehicles by name; empty if one window holds all.

    Raises:
        MeasurementError: A vehicle was never in the region of the others.
    """
    region, found = forecasts.region, dict[str, Region]()
    follows = region if region is not None and region.follows else None
    box = bounds_of(forecasts.ensemble.grid) if follows is None else follows.bounds
    for vehicle in job.vehicles:
        held = [place for place in vehicle.places if inside_box(box, *place)]
        if held and follows is not None:
            found[vehicle.name] = follows.about(held[0])
        elif vehicle.places and not held:
            longitude, latitude = vehicle.places[-1]
            anew = ", or delete the folder of states: the first logs chose the region"
            raise MeasurementError(
                f"{vehicle.name}: was at {latitude:.2f} N, {longitude:.2f} E, outside the region of the forecast; "
                f"replay it separately, with a forecast of its place{anew if job.following else ''}"
            )
    return found
