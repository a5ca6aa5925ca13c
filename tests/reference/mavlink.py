"""MAVLink, a bit and an entry at a time."""


def slow_chain(records: list[tuple[int, int]]) -> list[int]:
    """Which of some (start, end) are met when each search begins at the end of the record before."""
    met, at = [], 0
    for number, (start, end) in enumerate(records):
        if start >= at:
            met.append(number)
            at = end
    return met
