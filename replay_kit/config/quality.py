"""``[measurements]``: thresholds of ``quality`` for bins and track, and rules of ``without`` (data denial).

``None`` switches a test off. A bin beyond ``*_suspect`` is flagged 3, beyond ``*_fail`` 4, as in QARTOD, "Manual for Real-Time Quality
Control of In-Situ Current Observations" (U.S. IOOS), which names the tests and leaves the thresholds to the operator. TOML has no null;
write ``"off"`` there.
"""

import re
from collections.abc import Sequence
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, PlainSerializer, model_validator

from replay_kit.config.file import NotNegative, Section


def _off_is_none(value: object) -> object:
    return None if value == "off" else value


def _none_is_off(value: float | None) -> float | str:
    """Return the word for None, so that recorded settings, which omit None, read back unchanged."""
    return "off" if value is None else value


_Limit = Annotated[
    NotNegative | None,
    BeforeValidator(_off_is_none),
    PlainSerializer(_none_is_off, return_type=float | str),
]
# units of the tests for values below their limits, and of those for values above them
_LEAST = {
    "correlation": "%",
    "nortek_correlation": "%",
    "amplitude": "dB",
    "snr": "dB",
    "percent_good": "%",
}
_MOST = {"error_velocity": "m/s", "speed": "m/s", "tilt": "degrees", "outlier": "median deviations"}


def _limit(quantity: str, side: str, unit: str, default: float | None, note: str = "") -> Any:
    """Return the setting of a threshold; its name states whether a bin beyond it is suspect or fails."""
    return Field(
        default=default,
        description=f"{quantity} {side} which a bin is flagged [{unit}]{note and '; '}{note}.",
    )


class QualityConfig(Section):
    """``[measurements.quality]``: thresholds beyond which bins are suspect or fail."""

    use_suspect: bool = Field(default=True, description="Use suspect bins; off makes them fail.")
    correlation_suspect: _Limit = _limit(
        "Correlation", "below", "%", None, "Teledyne states one threshold only"
    )
    correlation_fail: _Limit = _limit(
        "Correlation of the third best beam", "below", "%", 25.0, "Teledyne's WC, 64 of 255 counts"
    )
    nortek_correlation_suspect: _Limit = _limit(
        "Correlation", "below", "%", None, "for pings whose attitude_convention is nortek"
    )
    nortek_correlation_fail: _Limit = _limit(
        "Correlation of the third best beam",
        "below",
        "%",
        50.0,
        "for such pings; Nortek's own limit",
    )
    amplitude_suspect: _Limit = _limit(
        "Amplitude", "below", "dB", None, "what is low depends on the instrument"
    )
    amplitude_fail: _Limit = _limit(
        "Amplitude of the third best beam",
        "below",
        "dB",
        10.0,
        "below the noise of every receiver, a dead channel",
    )
    snr_suspect: _Limit = _limit(
        "Signal-to-noise ratio of the third best beam",
        "below",
        "dB",
        6.0,
        "for pings with snr or noise_floor",
    )
    snr_fail: _Limit = _limit(
        "Signal-to-noise ratio of the third best beam",
        "below",
        "dB",
        3.0,
        "where manufacturers end the range",
    )
    percent_good_suspect: _Limit = _limit(
        "Share of three- and four-beam solutions", "below", "%", 50.0
    )
    percent_good_fail: _Limit = _limit(
        "Share of three- and four-beam solutions", "below", "%", 25.0
    )
    error_velocity_suspect: _Limit = _limit(
        "Error velocity", "above", "m/s", 0.8, "usual for single pings"
    )
    error_velocity_fail: _Limit = _limit("Error velocity", "above", "m/s", 2.0, "Teledyne's WE")
    speed_suspect: _Limit = _limit(
        "Speed over the ground", "above", "m/s", 3.0, "few ocean currents are faster"
    )
    speed_fail: _Limit = _limit(
        "Speed over the ground",
        "above",
        "m/s",
        None,
        "measurements.max_speed fails a component in any case",
    )
    tilt_suspect: _Limit = _limit(
        "Tilt",
        "above",
        "degrees from the vertical",
        15.0,
        "not for vehicles that dive, which tilt to glide",
    )
    tilt_fail: _Limit = _limit(
        "Tilt",
        "above",
        "degrees from the vertical",
        30.0,
        "the limit of Nortek's tilt sensor and bin mapping",
    )
    sidelobe: bool = Field(
        default=True,
        description="Fail bins that are contaminated by the side lobes' echo from the surface.",
    )
    beam_angle: float = Field(
        default=20.0,
        gt=0.0,
        lt=90.0,
        description="Angle of the beams from the instrument's axis in pings without beam_unit_vectors [degrees].",
    )
    outlier_suspect: _Limit = _limit(
        "Deviation from the neighbouring bins",
        "above",
        "median deviations, as standard deviations",
        4.0,
    )
    outlier_fail: _Limit = _limit(
        "Deviation from the neighbouring bins",
        "above",
        "median deviations, as standard deviations",
        6.0,
    )
    at_surface: Literal["off", "suspect", "fail"] = Field(
        default="suspect",
        description="Treatment of pings above measurements.surface_depth from a vehicle that dives.",
    )

    @model_validator(mode="after")
    def _suspect_comes_first(self) -> Self:
        for name in (*_LEAST, *_MOST):
            suspect, fail = self.limits(name)
            if (
                suspect is not None
                and fail is not None
                and (suspect < fail if name in _LEAST else suspect > fail)
            ):
                raise ValueError(
                    f"{name}_suspect {suspect:g} is beyond {name}_fail {fail:g}; a bin is suspect before it fails"
                )
        return self

    def limits(self, name: str) -> tuple[float | None, float | None]:
        """Return the thresholds of a test: suspect and fail."""
        return getattr(self, f"{name}_suspect"), getattr(self, f"{name}_fail")

    def limits_in_words(self, name: str) -> tuple[str, str]:
        """Return the thresholds of a test with sign and unit, suspect and fail; empty without thresholds."""
        sign, unit = ("<", _LEAST[name]) if name in _LEAST else (">", _MOST[name])
        suspect, fail = (
            "" if limit is None else f"{sign} {limit:g} {unit}" for limit in self.limits(name)
        )
        return suspect, fail


_KINDS = ("dac", "profiles", "shear", "radar", "drifters", "sensors")
_EXPECTED = f"expected {', '.join(_KINDS)} or dives:3-5"


def checked_rules(rules: Sequence[str]) -> None:
    """Raise ValueError for an invalid or duplicate rule."""
    for rule in rules:
        if rule in _KINDS:
            continue
        found = re.fullmatch(r"dives:(\d{1,9})(?:-(\d{1,9}))?", rule)
        if found is None:
            raise ValueError(f"{_EXPECTED}; '{rule}' is none of them")
        first, last = _dives(rule)
        if first < 1 or last < first:
            raise ValueError(
                f"{_EXPECTED}; in '{rule}' dives count from 1, the first before the last"
            )
    if repeated := sorted({rule for rule in rules if list(rules).count(rule) > 1}):
        raise ValueError(f"{_EXPECTED}, each once; '{repeated[0]}' is there twice")


def rules_for(rules: Sequence[str], kind: str, dive: int) -> tuple[str, ...]:
    """Return the rules that withhold a measurement.

    Args:
        rules: Rules as configured.
        kind: Kind of the measurement.
        dive: Number of its dive; 0 before the first dive, or without dives.
    """
    return tuple(
        rule
        for rule in rules
        if rule == kind or (rule not in _KINDS and _dives(rule)[0] <= dive <= _dives(rule)[1])
    )


def _dives(rule: str) -> tuple[int, int]:
    """Return the first and last dive of a rule ``dives:FIRST-LAST``."""
    first, _, last = rule.partition(":")[2].partition("-")
    return int(first), int(last or first)
