"""The fit of a clock, slow and obvious: every pair of pairs, one scalar at a time."""

import statistics


def slow_fit(boot_ns: list[int], utc_ns: list[int], with_drift: bool) -> tuple[float, float]:
    """(drift, median offset [ns] at boot time 0, the drift taken off), in exact integers as far as they go."""
    slopes = [
        (utc_ns[j] - utc_ns[i] - boot_ns[j] + boot_ns[i]) / (boot_ns[j] - boot_ns[i])
        for i in range(len(boot_ns))
        for j in range(i + 1, len(boot_ns))
        if boot_ns[j] != boot_ns[i]
    ]
    drift = statistics.median(slopes) if with_drift else 0.0
    return drift, statistics.median(
        utc - boot - drift * boot for boot, utc in zip(boot_ns, utc_ns, strict=True)
    )
