"""MAVLink, a bit and an entry at a time."""


def slow_crc(covered: bytes) -> int:
    """The checksum of a frame's bytes after its marker, with the byte of the message's definition at their end."""
    register = 0xFFFF
    for byte in covered:
        register ^= byte
        for _ in range(8):
            register = register >> 1 ^ (0x8408 if register & 1 else 0)
    return register


def slow_chain(records: list[tuple[int, int]]) -> list[int]:
    """Which of some (start, end) are met when each search begins at the end of the record before."""
    met, at = [], 0
    for number, (start, end) in enumerate(records):
        if start >= at:
            met.append(number)
            at = end
    return met
