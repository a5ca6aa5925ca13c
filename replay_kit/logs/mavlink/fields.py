"""The fields of MAVLink messages: one unpacker for each kind, made from pymavlink's definitions."""

from collections.abc import Callable
from operator import itemgetter
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

Unpack = Callable[[bytes], dict[str, Any]]


def unpacker(message_id: int) -> Unpack:
    """Return the function from a payload to its fields, for a message of the dialect.

    The zeros that MAVLink 2 cuts off at the end of a payload are filled in; of a longer payload, with fields that are not in the
    dialect, the known fields are read. Character arrays are text without the padding.
    """
    message = dialect.mavlink_map[message_id]
    size, unpack, names = (
        message.unpacker.size,
        message.unpacker.unpack_from,
        tuple(message.fieldnames),
    )
    # on the wire the fields have another order; an array is several values, a text is one
    if max(message.lengths) > 1 or "char" in message.fieldtypes:
        ends = [sum(message.lengths[: place + 1]) for place in range(len(names))]
        wire = [
            slice(end - n, end) if n > 1 else end - 1
            for n, end in zip(message.lengths, ends, strict=True)
        ]
        places = [(name, wire[order]) for name, order in zip(names, message.orders, strict=True)]

        def mixed(payload: bytes) -> dict[str, Any]:
            values = unpack(payload if len(payload) >= size else payload.ljust(size, b"\0"))
            return {name: _value(values[place]) for name, place in places}

        return mixed
    ordered = itemgetter(*message.orders) if len(names) > 1 else tuple

    def numbers(payload: bytes) -> dict[str, Any]:
        values = unpack(payload if len(payload) >= size else payload.ljust(size, b"\0"))
        return dict(zip(names, ordered(values), strict=True))

    return numbers


def _value(value: Any) -> Any:
    if isinstance(value, bytes):
        return value.split(b"\0", 1)[0].decode("ascii", errors="replace")
    return list(value) if isinstance(value, tuple) else value
