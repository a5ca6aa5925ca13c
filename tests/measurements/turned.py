"""One message as a row of a table, and one ping after all rotations."""

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.message import Message
from replay_kit.core.observation.table import Rows, Table
from replay_kit.logs.tables.columns import raws_of
from replay_kit.logs.tables.schemas import tables_of
from replay_kit.measurements.profiles.earth import no_triples, to_earth
from replay_kit.measurements.profiles.frames import attitude_of

CONFIG, NO_ATTITUDE = MeasurementConfig(), no_triples()


def quaternion(rotation: Rotation, factor: float = 1.0) -> dict[str, float]:
    """Return a rotation as a message has it."""
    return dict(zip("xyzw", (factor * rotation.as_quat()).tolist(), strict=True))


def of_quaternion(message: Mapping[str, float], time_ns: int = 0) -> Rows:
    """Return the attitude of a body, east, north, up, at a time."""
    turn = np.array([[message[name] for name in "xyzw"]])
    values = attitude_of(turn, np.zeros(1, bool))
    return {"time": np.array([time_ns]), "order": np.array([-1]), "values": values}


def table_of(message: Message, config: MeasurementConfig) -> Table:
    """Return the table of a message; ValueError says why it is not used."""
    table = tables_of(raws_of([message]), config)[0][-1]
    if table.kind == "unused":
        raise ValueError(table["reason"][0])
    return table


def stated(message: Message, config: MeasurementConfig = CONFIG) -> SimpleNamespace:
    """Return the columns of a message's row, and what is fixed of its table; ValueError says why it is not used."""
    return row_of(table_of(message, config))


def row_of(table: Table) -> SimpleNamespace:
    """Return the columns of a table's first row, and what is fixed of it."""
    columns = {name: column[0] for name, column in table.columns.items()}
    return SimpleNamespace(kind=table.kind, **columns, **table.fixed)


def turned(
    payload: Mapping[str, Any],
    config: MeasurementConfig = CONFIG,
    attitudes: Mapping[str, Any] = NO_ATTITUDE,
) -> SimpleNamespace:
    """Return the columns of a ping as ``earth.to_earth`` gives them; ValueError says why it is not used, or cannot be turned."""
    table = table_of(Message(0, "/adcp", "replay_kit.AdcpPing", payload, 0, 0), config)
    columns = to_earth(table, attitudes, no_triples(), config).columns
    if columns["why"][0]:
        raise ValueError(columns["why"][0])
    return SimpleNamespace(**{name: np.asarray(column)[0] for name, column in columns.items()})
