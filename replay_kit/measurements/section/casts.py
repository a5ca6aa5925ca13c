"""Samples of a CTD to the profiles of a dive: means over layers as they come, and the legs down and up when the vehicle has surfaced."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import gsw
import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import unwrap_longitude
from replay_kit.core.observation import Source, VehicleState
from replay_kit.measurements.section.hydrography import Profile
from replay_kit.measurements.vehicle.dives import legs_of

# m; layers over which samples are averaged, and a shorter leg is no profile
_LAYER, _LEG = 4.0, 40.0
# s; a longer time without a sample ends a leg, and mS/cm of one S/m
_GAP, _MS_CM = 1800.0, 10.0

#: Depth [m], temperature [degrees C], salinity, conductivity [S/m] and pressure [dbar].
Sample = tuple[float, float, float, float, float]


@dataclass(frozen=True, slots=True)
class Cast:
    """The samples since the last surfacing, averaged over layers.

    Attributes:
        source: Of the first sample; None before it.
        start: Last fix before the first sample; None without.
        layers: Time since the first sample [s] and mean of the samples, layer after layer as they were passed.
        sums: Number of samples in the layer that is being passed, and sums over them in the form of ``layers``.
        last_ns: Of the last [ns, UTC].
        samples: How many.
    """

    source: Source | None = None
    start: VehicleState | None = None
    layers: tuple[tuple[float, ...], ...] = ()
    sums: tuple[float, ...] = ()
    last_ns: int = 0
    samples: int = 0

    @property
    def first_ns(self) -> int:
        """Time of the first sample [ns, UTC]; 0 before it."""
        return 0 if self.source is None else self.source.time_ns

    def after(self, source: Source, fix: VehicleState, sample: Sample) -> "Cast":
        """Return the cast with one more sample, not earlier than the last.

        Args:
            source: Its message.
            fix: The last position before it.
            sample: The sample.
        """
        first = self.source or source
        start = self.start if self.samples or fix.dead_reckoned else fix
        place = fix.longitude, fix.latitude
        values = (1.0, (source.time_ns - first.time_ns) * 1e-9, *place, *sample)
        layers, sums, depth = self.layers, self.sums, sample[0]
        if sums and depth // _LAYER != (sums[4] / sums[0]) // _LAYER:
            layers, sums = (*layers, _mean(sums)), ()
        sums = tuple(a + b for a, b in zip(sums, values, strict=True)) if sums else values
        return Cast(first, start, layers, sums, source.time_ns, self.samples + 1)

    def profiles(self, end: VehicleState | None, surface_depth: float) -> list[Profile]:
        """Return the profile of each leg; salinity is computed from conductivity where none is stated.

        Args:
            end: The fix after the dive, to which places are moved linearly in time from the fix before it; None leaves them.
            surface_depth: [m], shallower than this the vehicle is at the surface.
        """
        if not self.sums:
            return []
        time, longitude, latitude, depth, temperature, salinity, conductivity, pressure = np.array(
            [*self.layers, _mean(self.sums)]
        ).T
        if end is not None and self.start is not None and end.time_ns > self.start.time_ns:
            share = (time * 1e9 + self.first_ns - self.start.time_ns) / (
                end.time_ns - self.start.time_ns
            )
            east = float(unwrap_longitude(end.longitude, self.start.longitude))
            longitude = self.start.longitude + share * (east - self.start.longitude)
            latitude = self.start.latitude + share * (end.latitude - self.start.latitude)
        with np.errstate(invalid="ignore"):
            computed = gsw.SP_from_C(
                _MS_CM * conductivity,
                temperature,
                np.where(np.isfinite(pressure), pressure, gsw.p_from_z(-depth, latitude)),
            )
        salinity = np.where(np.isfinite(salinity), salinity, computed)
        time_ns = self.first_ns + (time * 1e9).astype(np.int64)
        of_legs = legs_of(time_ns, depth, surface_depth, _LEG, _GAP)
        table = (longitude, latitude, depth, temperature, salinity)
        return [
            Profile(time_ns[at], *(values[at] for values in table))
            for at in (of_legs == number for number in range(1, int(of_legs.max()) + 1))
        ]

    def columns(self) -> tuple[Array, Array, Array]:
        """Return depth [m], conductivity [S/m] and pressure [dbar] of the layers, shapes (n,)."""
        _, _, _, depth, _, _, conductivity, pressure = np.array([*self.layers, _mean(self.sums)]).T
        return depth, conductivity, pressure


def _mean(sums: Sequence[float]) -> tuple[float, ...]:
    return tuple(value / sums[0] for value in sums[1:])


def without_spikes(profile: Profile) -> tuple[Profile, float]:
    """Return a profile without salinity that stands out of its neighbours, and the share of its samples that does."""
    salinity = profile.salinity
    padded = np.pad(salinity, 2, mode="edge")
    near = np.lib.stride_tricks.sliding_window_view(padded, 5)
    with np.errstate(invalid="ignore"):
        away = np.abs(salinity - np.median(near, axis=1))
        bad = away > max(_SPIKE, 6.0 * float(np.nanmedian(away)))
    return replace(profile, salinity=np.where(bad, np.nan, salinity)), float(bad.mean())


# Practical salinity by which a spike stands out at least.
_SPIKE = 0.05
