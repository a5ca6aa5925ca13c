"""The message of a dive that was expected to surface at one place and surfaced at another."""

from replay_kit.core.observation import Fix
from replay_kit.core.surfacing import DiveForecast, DiveOutcome
from replay_kit.results.messages import stamp
from replay_kit.results.schemas import encode


def surfacing_message(outcome: DiveOutcome) -> bytes:
    """Return ``replay_kit.Surfacing``; figures of the last dive's current are NaN where it has no spread yet."""
    forecast = outcome.forecast
    begin, end = stamp(forecast.start.time_ns), stamp(outcome.fix.time_ns)
    return encode(
        "Surfacing",
        {
            "timestamp": {"seconds": end.sec, "nanos": end.nsec},
            "dive_begin": {"seconds": begin.sec, "nanos": begin.nsec},
            "dive": forecast.dive,
            "earlier_dives": forecast.earlier,
            "start": _place(forecast.start),
            "expected": _place(forecast),
            "actual": _place(outcome.fix),
            "distance": outcome.distance,
            "direction_deg": outcome.direction_deg,
            "ellipse_bearing": forecast.outer.bearing_deg,
            "inner_major": forecast.inner.major,
            "inner_minor": forecast.inner.minor,
            "outer_major": forecast.outer.major,
            "outer_minor": forecast.outer.minor,
            "inside_inner": outcome.in_inner,
            "inside_outer": outcome.in_outer,
            "log_score": outcome.log_score,
            "persistent_log_score": outcome.persistent_log_score,
            "persistent_distance": outcome.persistent_distance,
            "persistent_radius": forecast.persistent_radius,
        },
    )


def _place(place: Fix | DiveForecast) -> dict[str, float]:
    return {"longitude": place.longitude, "latitude": place.latitude, "depth": 0.0}
