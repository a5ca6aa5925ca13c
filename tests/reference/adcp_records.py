"""Where the sound records of a raw ADCP file are, found byte by byte."""

import struct


def slow_records(data: bytes, nortek: bool) -> list[tuple[int, int, int]]:
    """Return start, end and kind of the records of PD0, whose ensembles are of kind 0, or of AD2CP."""
    if nortek:
        return _walk(data, 0, len(data), _ad2cp)
    found, ended = [], 0
    for record in [*_walk(data, 0, len(data), _pd0), None]:
        found += _walk(data, ended, len(data) if record is None else record[0], _packet)
        if record is not None:
            found.append(record)
            ended = record[1]
    return found


def _walk(data, at, last, end_of):
    found = []
    while at < last:
        end, kind = end_of(data, at)
        if 0 < end <= last:
            found.append((at, end, kind))
            at = end
        else:
            at += 1
    return found


def _packet(data: bytes, at: int) -> tuple[int, int]:
    if data[at] != 0x7F or at + 6 > len(data) or data[at + 1] == 0x7F:
        return 0, 0
    end = at + int.from_bytes(data[at + 2 : at + 4], "little")
    sound = end >= at + 4 and int.from_bytes(data[end : end + 2], "little") == (
        sum(data[at:end]) % 65536
    )
    return (end + 2, data[at + 1]) if sound and end + 2 <= len(data) else (0, 0)


def _pd0(data: bytes, at: int) -> tuple[int, int]:
    if data[at : at + 2] != b"\x7f\x7f" or at + 8 > len(data):
        return 0, 0
    size, _, types, first = struct.unpack_from("<HBBH", data, at + 2)
    if types == 0 or first != 6 + 2 * types or size < first + 2 or at + size + 2 > len(data):
        return 0, 0
    leader, check = (
        int.from_bytes(data[at + place : at + place + 2], "little") for place in (first, size)
    )
    return (
        (at + size + 2, 0)
        if leader in (0, 1) and sum(data[at : at + size]) % 65536 == check
        else (0, 0)
    )


def _ad2cp(data: bytes, at: int) -> tuple[int, int]:
    length = {b"\xa5\x0a": 10, b"\xa5\x0c": 12}.get(data[at : at + 2], len(data) + 1)
    if at + length > len(data):
        return 0, 0
    size, check, head_check = struct.unpack_from("<HHH" if length == 10 else "<IHH", data, at + 4)
    head, body = data[at : at + length - 2], data[at + length : at + length + size]
    sound = len(body) == size and nortek_sum(head) == head_check and nortek_sum(body) == check
    return (at + length + size, data[at + 2]) if sound else (0, 0)


def nortek_sum(part: bytes) -> int:
    """Return the checksum of the head or content of an AD2CP record."""
    even = part if len(part) % 2 == 0 else part[:-1] + b"\0" + part[-1:]
    return (0xB58C + sum(struct.unpack(f"<{len(even) // 2}H", even))) % 65536
