"""One ping after all rotations."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.message import Message
from replay_kit.logs.tables.columns import raws_of
from replay_kit.logs.tables.schemas import tables_of
from replay_kit.measurements.earth import Attitudes, Motions, to_earth


def turned(payload: Mapping[str, Any], config: MeasurementConfig) -> dict[str, Any]:
    """Return the columns of a ping as ``earth.to_earth`` gives them; ValueError says why there are none."""
    message = Message(0, "/adcp", "replay_kit.AdcpPing", payload, 0, 0)
    (table,) = tables_of(raws_of([message]), config)[0]
    if table.kind == "unused":
        raise ValueError(table["reason"][0])
    columns, why = to_earth(table, Attitudes(), Motions(), config)
    if why[0]:
        raise ValueError(why[0])
    return {name: np.asarray(column)[0] for name, column in columns.items()}
