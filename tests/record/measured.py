"""What logs say: events by kind, what is not used and why, flags and reasons of bins, and summed positions and values by topic."""

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import replay_kit as rk
from replay_kit.config.run import LogConfig, MeasurementConfig
from replay_kit.core.observation import Flag, Observation, PathMean, Reason, VehicleState
from replay_kit.logs import merge, open_logs
from tests.measurements.samples import Skipped, Used, events_of
from tests.places import DATA, SAMPLES

_CASES = DATA.parent / "cases-4"
# Names of logs in the folders of real data; those of one pattern are one log each, those after ``+`` together.
_FOLDERS = (
    *("adcp/*.000", "adcp/*.ENX", "adcp/*.PD0", "adcp/*.ad2cp", "glider/*.nc", "hfradar/+*.nc"),
    *("hfradar/+*.ruv", "logs/ardusub/small.*", "logs/ros2-vehicle/*.mcap", "logs/rosbag2/*.mcap"),
    *("glider/seaexplorer/+sea046*", "glider/seaexplorer/+sea063*", "logs/mcap-conformance/*/+*"),
    *("seaglider/+p1710*.nc", "seaglider/+p2490*.nc", "slocum/+*.?bd"),
)
_QUALITY = ("flags", "reasons")
_KINDS = {VehicleState: "position", Observation: "profile", PathMean: "mean current"}


def logs() -> dict[str, list[Path]]:
    """Return the logs that are there, by name: the samples, and each of the real data and of the cases."""
    found = {path.name: [path] for path in sorted(SAMPLES.glob("*.[mt][cl]*"))}
    for pattern in _FOLDERS:
        together = "+" in pattern
        paths = sorted(DATA.glob(pattern.replace("+", "")))
        if together and paths:
            found[pattern.replace("+", "")] = paths
        elif not together:
            found |= {path.relative_to(DATA).as_posix(): [path] for path in paths}
    for case in sorted(_CASES.glob("*/")):
        files = [path for path in sorted(case.rglob("*.*")) if path.suffix != ".md"]
        slocum = [path for path in files if path.parent != case]
        alone = [path for path in files if path not in slocum and path.name != "forecast.nc"]
        found |= {path.relative_to(_CASES).as_posix(): [path] for path in alone}
        if slocum:
            found[f"{case.name}/slocum"] = slocum
    return found


def answers(names: Iterable[str]) -> dict[str, Any]:
    """Return what some of ``logs`` say, by name."""
    known = logs()
    return {name: answer(known[name]) for name in names}


def answer(paths: Sequence[Path]) -> dict[str, Any]:
    """Return what a log says, of one file or several; where it is refused, the kind of error.

    ``read`` is the number of messages, ``lost`` that of lost bytes, ``late`` that of messages left out as late, ``skipped`` by topic and
    reason, and ``topics`` as of ``_summary``.
    """
    config = LogConfig()
    try:
        readers = open_logs(list(paths), config, several_missions=True)
        merged = merge(readers, config.reorder_window)
        events = [one for each in events_of(merged, MeasurementConfig()) for one in each]
    except rk.ReplayKitError as error:
        return {"refused": type(error).__name__}
    reports = [reader.report() for reader in readers]
    skipped = Counter(f"{one.topic}: {one.reason}" for one in events if isinstance(one, Skipped))
    by_topic = defaultdict(list)
    for one in events:
        if not isinstance(one, Skipped | Used):
            by_topic[_KINDS.get(type(one), "other"), one.source.topic].append(one)
    return {
        "read": sum(sum(report.read.values()) for report in reports),
        "lost": sum(loss.bytes for report in reports for loss in report.losses),
        "undecodable": sum(count for report in reports for count, _ in report.undecodable.values()),
        "late": sum(merged.late.values()),
        "used": sum(isinstance(one, Used) for one in events),
        "skipped": dict(sorted(skipped.items())),
        "topics": {
            f"{kind} {topic}": _summary(found) for (kind, topic), found in sorted(by_topic.items())
        },
    }


def _summary(events: Sequence[Any]) -> Mapping[str, Any]:
    """Return number, first and last time of the measurements or positions of a topic, flags and reasons of their bins by number.

    Of each of the places and values there are the number of finite ones, their mean, their RMS about it, the first and the last; degrees
    are in millionths.
    """
    found: dict[str, Any] = {
        "n": len(events),
        "first": events[0].time_ns,
        "last": events[-1].time_ns,
    }
    rows = [one if isinstance(one, VehicleState) else one.linear for one in events]
    columns = [_columns(row) for row in rows]
    if not isinstance(rows[0], VehicleState):
        flags, bits = (np.concatenate([getattr(row, of) for row in rows]) for of in _QUALITY)
        found["flags"] = {
            flag.name: int(np.sum(flags == flag)) for flag in Flag if np.any(flags == flag)
        }
        found["reasons"] = {
            reason.name: int(np.count_nonzero(bits & reason))
            for reason in Reason
            if np.any(bits & reason)
        }
    for name in columns[0]:
        values = np.concatenate([np.ravel(each[name]) for each in columns])
        values = values[np.isfinite(values)]
        if values.size:
            degrees = name in ("longitude", "latitude")
            values = 1e6 * values if degrees else values
            spread = np.sqrt(np.mean((values - values.mean()) ** 2))
            figures = map(float, (values.mean(), spread, values[0], values[-1]))
            found[name] = [values.size, *(map(round, figures) if degrees else figures)]
    return found


def _columns(row: Any) -> dict[str, Any]:
    """Return where a position or a measurement is, and what it measures."""
    place = {name: getattr(row, name) for name in ("longitude", "latitude", "depth")}
    if isinstance(row, VehicleState):
        return place
    return place | dict(zip("uv", row.value.T, strict=False)) | {"error": row.error_std}
