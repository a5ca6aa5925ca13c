"""Layout of Foxglove and Lichtblick for a result: map, 3D scene, plots, log and a table of findings.

Both read one form: ``configById`` holds each panel's settings under its type and a name, ``layout`` a tree of them with ``first``,
``second``, ``direction`` and ``splitPercentage``. Only topics of the result are named, with fields of their schemas.
"""

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from replay_kit.core.atomic import write_whole
from replay_kit.core.colors import DARK, SYMBOLS, scale
from replay_kit.core.errors import LogError
from replay_kit.results.reader import ResultReader

_DEPTH = re.compile(r"/flow/grid/(.+)m")
# Of lines, the track and the plan, as on a dark page: viewers are dark.
_COLORS = tuple(DARK[role] for role in ("one", "two", "three", "four"))
_TRACK, _PLAN = (DARK[SYMBOLS[name][0]] for name in ("track", "plan"))
# Standard errors and speeds of the colour scales [m/s].
_ERROR, _SPEED = 0.2, 0.5
_LEGEND_AND_AXES = {
    "showLegend": True,
    "legendDisplay": "floating",
    "showPlotValuesInLegend": True,
    "sidebarDimension": 240,
    "showXAxisLabels": True,
    "showYAxisLabels": True,
    "isSynced": True,
    "xAxisVal": "timestamp",
}
_TITLES = {
    "speed": "Vehicle, plan and speed of the current",
    "u_standard_error": "Standard error, along local east",
    "v_standard_error": "Standard error, along local north",
}


def write_layout(result: Path, out: Path) -> int:
    """Write the layout for a result, also of an earlier version, and return the number of its panels.

    Raises:
        LogError: The file is missing or no complete result.
        ConfigError: The layout cannot be written.
    """
    topics = [*ResultReader(result).topics]
    require_topics(topics, str(result))
    layout = layout_of(topics)
    write_whole(out, layout_text(layout))
    return len(layout["configById"])


def layout_of(topics: Iterable[str]) -> dict[str, Any]:
    """Return the layout of a result with the given topics."""
    has = frozenset(topics)
    panels: dict[str, dict[str, Any]] = {
        "map!track": _map(has),
        "3D!speed": _scene(has, "speed", _SPEED),
        **{f"3D!error_{axis}": _scene(has, f"{axis}_standard_error", _ERROR) for axis in "uv"},
        "Plot!innovations": _plot(
            "Innovations and their expected standard deviations [m/s]",
            "/flow/innovation",
            *(f"innovation{std}_{end}[:]" for std in ("", "_std") for end in ("east", "north")),
        ),
        "RosOut!log": {
            "topicToRender": "/log",
            "minLogLevel": 1,
            "searchTerms": [],
            "foxglovePanelTitle": "Log",
        },
        "Table!consistency": {
            "topicPath": "/flow/consistency.findings",
            "foxglovePanelTitle": "Contradictions",
        },
    }
    errors = _split("3D!error_u", "3D!error_v", "column", 50)
    pictures = _split("map!track", _split("3D!speed", errors, "row", 60), "row", 36)
    plots: Any = "Plot!innovations"
    if "/plan/outcome" in has:
        title = "Surfacings against predictions: distance [m], delay [s]"
        panels["Plot!surfacings"] = _plot(title, "/plan/outcome", "distance", "delay")
        plots = _split(plots, "Plot!surfacings", "row", 66)
    words = _split("RosOut!log", "Table!consistency", "row", 50)
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 5},
        "layout": _split(pictures, _split(plots, words, "column", 60), "column", 58),
    }


def layout_text(layout: Mapping[str, Any]) -> str:
    """Return a layout as the text of its file."""
    return json.dumps(layout, indent=1, allow_nan=False) + "\n"


def require_topics(topics: Sequence[str], name: str) -> None:
    """Raise LogError if a file has no topic of a result."""
    if not any(topic.startswith(("/flow/", "/plan/")) for topic in topics):
        raise LogError(
            f"{name}: expected a result of replay-kit replay, it has no topic /flow/ or /plan/; give a result"
        )


def _split(first: Any, second: Any, direction: str, percentage: int) -> dict[str, Any]:
    return {"first": first, "second": second, "direction": direction, "splitPercentage": percentage}


def _map(has: frozenset[str]) -> dict[str, Any]:
    colors = {
        topic: color
        for topic, color in (("/vehicle/fix", _TRACK), ("/plan/geojson", _PLAN))
        if topic in has
    }
    return {
        "layer": "map",
        "followTopic": "/vehicle/fix" if "/vehicle/fix" in has else "",
        "topicColors": colors,
        "zoomLevel": 9,
        "disabledTopics": [],
        "foxglovePanelTitle": "Map",
    }


def _scene(has: frozenset[str], field: str, most: float) -> dict[str, Any]:
    """Return the 3D panel, with the shallowest slice shown and the others switched off."""
    depths = {topic: match[1] for topic in has if (match := _DEPTH.fullmatch(topic))}
    grids = sorted(depths, key=lambda topic: float(depths[topic]))
    colors = scale("speed-dark" if field == "speed" else "amp")
    shown = {
        "colorMode": "gradient",
        "gradient": [f"{colors[k][1]}ff" for k in (0, -1)],
        "colorField": field,
        "minValue": 0.0,
        "maxValue": most,
        "frameLocked": True,
    }
    topics: dict[str, dict[str, Any]] = {
        topic: {"visible": k == 0, **shown} for k, topic in enumerate(grids)
    }
    arrows = [topic.replace("/grid/", "/arrows/") for topic in grids]
    topics |= {topic: {"visible": k == 0} for k, topic in enumerate(arrows) if topic in has}
    others: dict[str, dict[str, Any]] = {
        "/flow/surface": {"visible": False, **shown},
        "/plan/path": {
            "visible": True,
            "type": "line",
            "lineWidth": 300.0,
            "gradient": [_PLAN, _PLAN],
        },
        "/plan/seabed": {**shown, "visible": False, "colorField": "depth", "maxValue": 5000.0},
    }
    topics |= {topic: settings for topic, settings in others.items() if topic in has}
    return {
        "cameraState": {
            "distance": 150_000.0,
            "perspective": True,
            "phi": 40.0,
            "thetaOffset": 0.0,
            "target": [0, 0, 0],
            "targetOffset": [0, 0, 0],
            "targetOrientation": [0, 0, 0, 1],
            "fovy": 45,
            "near": 10.0,
            "far": 5_000_000.0,
        },
        "followMode": "follow-none",
        "followTf": "map",
        "scene": {"transforms": {"axisScale": 3000.0, "labelSize": 0.1, "showLabel": True}},
        "transforms": {
            "frame:vehicle": {"visible": True},
            "frame:map": {"visible": False},
            "frame:earth": {"visible": False},
        },
        "topics": topics,
        "layers": {},
        "publish": {},
        "imageMode": {},
        "foxglovePanelTitle": _TITLES[field],
    }


def _plot(title: str, topic: str, *fields: str) -> dict[str, Any]:
    rows = [
        {
            "value": f"{topic}.{field}",
            "enabled": True,
            "timestampMethod": "receiveTime",
            "label": field,
            "color": color,
            "showLine": False,
        }
        for field, color in zip(fields, _COLORS, strict=False)
    ]
    return {"paths": rows, **_LEGEND_AND_AXES, "foxglovePanelTitle": title}
