"""Results written the plain way: the stock writer, and ``json.dumps`` of the same content in the same messages."""

import base64
import json
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import Writer

from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.observation import Innovation, VehicleState
from replay_kit.results.slices import FIELDS, Slice, arrow_scale, depth_slice

_SECOND = 1_000_000_000


class JsonResults:
    """A result MCAP whose messages are JSON."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("wb")
        self._writer = Writer(self._file, enable_data_crcs=True)
        self._writer.start(profile="replay-kit")
        self._channels: dict[str, int] = {}

    def fix(self, state: VehicleState) -> None:
        pairs = [{"key": "dead_reckoned", "value": str(int(state.dead_reckoned))}]
        place = {"latitude": state.latitude, "longitude": state.longitude, "altitude": -state.depth}
        self._log(
            "/vehicle/fix", state.time_ns, {"frame_id": "vehicle", **place, "metadata": pairs}
        )

    def innovation(self, value: Innovation) -> None:
        said: dict[str, Any] = {
            "source_topic": value.source.topic,
            "source_position": value.source.position,
            "dive": value.dive,
            "depth": value.depth.tolist(),
            "nis": value.nis,
            "dof": value.dof,
            "accepted": value.accepted,
            "error_inflation": value.error_inflation,
            "flags": value.flags.tolist(),
            "reasons": value.reasons.tolist(),
        }
        for name in ("innovation", "innovation_std", "residual", "prior_innovation"):
            said[f"{name}_east"], said[f"{name}_north"] = getattr(value, name).T.tolist()
        self._log("/flow/innovation", value.time_ns, said)

    def estimate(self, time_ns: int, weights: Array, levels: Array) -> None:
        self._log(
            "/flow/estimate",
            time_ns,
            {
                "levels": levels.tolist(),
                "weights": weights.tolist(),
                "n_modes": weights.size // levels.size,
            },
        )

    def grids(self, time_ns: int, flow: FlowEstimate, depths: tuple[float, ...]) -> None:
        slices = [depth_slice(flow, depth) for depth in depths]
        scale = arrow_scale(slices) or 0.0
        for value in slices:
            self._log(f"/flow/grid/{value.depth:g}m", time_ns, _grid(value))
            self._log(f"/flow/arrows/{value.depth:g}m", time_ns, _arrows(value, scale))

    def close(self) -> None:
        self._writer.finish()
        self._file.close()

    def _log(self, topic: str, time_ns: int, value: dict[str, Any]) -> None:
        if topic not in self._channels:
            schema = self._writer.register_schema(topic, "jsonschema", b'{"type":"object"}')
            self._channels[topic] = self._writer.register_channel(topic, "json", schema)
        stamp = {"sec": time_ns // _SECOND, "nsec": time_ns % _SECOND}
        self._writer.add_message(
            self._channels[topic],
            time_ns,
            json.dumps({"timestamp": stamp, **value}).encode(),
            time_ns,
        )


def _grid(value: Slice) -> dict[str, Any]:
    speed = np.hypot(value.velocity[..., 0], value.velocity[..., 1])
    errors = [] if value.standard_error is None else [value.standard_error]
    packed = np.concatenate([value.velocity, speed[..., None], *errors], axis=-1).astype("<f4")
    return {
        "frame_id": "map",
        "pose": _pose(value.east[0], value.north[0], -value.depth, 0.0),
        "column_count": value.east.size,
        "cell_size": dict(zip("xy", value.cell, strict=True)),
        "fields": [
            {"name": name, "offset": 4 * k, "type": 7}
            for k, name in enumerate(FIELDS[: packed.shape[-1]])
        ],
        "data": base64.b64encode(packed.tobytes()).decode(),
    }


def _arrows(value: Slice, scale: float) -> dict[str, Any]:
    arrows = []
    for j, north in enumerate(value.north):
        for i, east in enumerate(value.east):
            u, v = value.velocity[j, i].tolist()
            length = scale * float(np.hypot(u, v))
            if length > 0.0:
                shape = {
                    "shaft_length": 0.65 * length,
                    "shaft_diameter": 0.2 * length,
                    "head_length": 0.35 * length,
                    "head_diameter": 0.4 * length,
                }
                color = {"r": 0.05, "g": 0.2, "b": 0.5, "a": 1.0}
                arrows.append(
                    {
                        "pose": _pose(east, north, -value.depth, float(np.arctan2(v, u))),
                        **shape,
                        "color": color,
                    }
                )
    return {"entities": [{"frame_id": "map", "id": f"flow {value.depth:g} m", "arrows": arrows}]}


def _pose(x: float, y: float, z: float, yaw: float) -> dict[str, Any]:
    turn = {"x": 0.0, "y": 0.0, "z": float(np.sin(0.5 * yaw)), "w": float(np.cos(0.5 * yaw))}
    return {"position": {"x": float(x), "y": float(y), "z": z}, "orientation": turn}
