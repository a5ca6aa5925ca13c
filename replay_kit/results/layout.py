"""Layout of Foxglove and Lichtblick for a result: map, 3D scene, plots, log and a table of findings.

Both read one form, ``panels.json``: ``configById`` holds each panel's settings under its type and a name, ``layout`` a tree of them. Of
topics only those of the result are kept; one that ends in ``/`` stands for those of all depths.
"""

import json
from collections.abc import Iterable, Mapping
from copy import deepcopy
from importlib.resources import files
from pathlib import Path
from typing import Any

from replay_kit.core.errors import LogError
from replay_kit.core.files.atomic import write_whole
from replay_kit.core.words.colors import scale
from replay_kit.results.reader import ResultReader

# Largest standard error of the colour scale [m/s].
_ERROR = 0.2


def write_layout(result: Path, out: Path) -> int:
    """Write the layout for a result, and return the number of its panels.

    Raises:
        LogError: The file is missing or no complete result.
        ConfigError: The layout cannot be written.
    """
    topics = [*ResultReader(result).topics]
    if not any(topic.startswith(("/flow/", "/plan/")) for topic in topics):
        raise LogError(
            f"{result}: expected a result of replay-kit replay, it has no topic /flow/ or /plan/; give a result"
        )
    layout = layout_of(topics)
    write_whole(out, layout_text(layout))
    return len(layout["configById"])


def layout_of(topics: Iterable[str]) -> dict[str, Any]:
    """Return the layout of a result with the given topics."""
    has = frozenset(topics)
    text = files("replay_kit.results").joinpath("panels.json").read_text(encoding="utf-8")
    layout: dict[str, Any] = _settings_of_topics(json.loads(text), has)
    panels, below = layout["configById"], layout["layout"]["second"]
    for axis, end in (("u", "east"), ("v", "north")):
        panels[f"3D!error_{axis}"] = scene = deepcopy(panels["3D!speed"])
        scene["foxglovePanelTitle"] = f"Standard error, along local {end}"
        for look in scene["topics"].values():
            if look.get("colorField") == "speed":
                look |= {"colorField": f"{axis}_standard_error", "maxValue": _ERROR}
            if "colorField" in look:
                look["gradient"] = [f"{scale('amp')[k][1]}ff" for k in (0, -1)]
    if "/vehicle/fix" not in has:
        panels["map!track"]["followTopic"] = ""
    if "/plan/outcome" not in has:
        del panels["Plot!surfacings"]
        below["first"] = below["first"]["first"]
    return layout


def _settings_of_topics(value: Any, has: frozenset[str]) -> Any:
    """Return settings with those of the topics of a result alone; of several depths the shallowest is shown."""
    if not isinstance(value, Mapping):
        return value
    found = dict[str, Any]()
    for key, item in value.items():
        if key.endswith("/"):
            depths = {float(topic[len(key) : -1]): topic for topic in has if topic.startswith(key)}
            names = [depths[depth] for depth in sorted(depths)]
            found |= {name: item | {"visible": name == names[0]} for name in names}
        elif key in has or not key.startswith("/"):
            found[key] = _settings_of_topics(item, has)
    return found


def layout_text(layout: Mapping[str, Any]) -> str:
    """Return a layout as the text of its file."""
    return json.dumps(layout, indent=1, allow_nan=False) + "\n"
