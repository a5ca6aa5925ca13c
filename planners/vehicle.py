"""Steady flight and energy of a glider, for NumPy arrays and CasADi expressions.

In steady flight along a path at the glide angle g below (or above) the horizontal, net buoyancy F balances drag and lift,

    F sin g = q S (c_d0 + c_d1 a^2),    F cos g = q S c_l a,    q = rho V^2 / 2,

so that the angle of attack is the small root of c_d1 a^2 - c_l tan(g) a + c_d0 = 0, the speed follows from either line, and the pitch is
g - a (Graver 2005; Merckelbach, Smeed, Griffiths 2010, J. Atmos. Oceanic Technol. 27, eqs. 8 to 11).
"""

from dataclasses import dataclass, field, replace
from math import inf
from statistics import NormalDist
from typing import Any

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError

GRAVITY = 9.81  # m/s^2
DENSITY = 1025.0  # kg/m^3, of sea water


@dataclass(frozen=True, slots=True)
class SteadyFlight:
    """Steady-flight model of a glider.

    Attributes:
        volume: Volume of net buoyancy, positive or negative [m^3].
        area: Reference area of the coefficients [m^2].
        drag: Parasitic drag coefficient of the hull, c_d0.
        induced_drag: Induced drag coefficient, c_d1 [1/rad^2].
        lift: Lift coefficient of hull and wings, c_l [1/rad].
    """

    volume: float = 2.3e-4
    area: float = 0.1
    drag: float = 0.15
    induced_drag: float = 2.9
    lift: float = 6.1

    def angle_of_attack(self, maths: Any, glide_angle: Any) -> Any:
        """Return the angle of attack [rad] at a glide angle [rad] above ``shallowest``; ``maths`` is ``numpy`` or ``casadi``."""
        lift = self.lift * maths.tan(glide_angle)
        # the small root, written without the difference of two nearly equal numbers
        return 2.0 * self.drag / (lift + maths.sqrt(lift**2 - 4.0 * self.drag * self.induced_drag))

    def speed(self, maths: Any, glide_angle: Any) -> Any:
        """Return the speed through water [m/s] at a glide angle [rad] above ``shallowest``."""
        attack = self.angle_of_attack(maths, glide_angle)
        resistance = 0.5 * DENSITY * self.area * (self.drag + self.induced_drag * attack**2)
        return maths.sqrt(DENSITY * GRAVITY * self.volume * maths.sin(glide_angle) / resistance)

    @property
    def shallowest(self) -> float:
        """Smallest glide angle of steady flight [rad]."""
        return float(np.arctan(2.0 * np.sqrt(self.drag * self.induced_drag) / self.lift))


@dataclass(frozen=True, slots=True)
class Glider:
    """Buoyancy-driven glider.

    Attributes:
        speed: Speed through water [m/s], used without ``flight``.
        flight: Steady-flight model of the speed at each glide angle.
        min_angle: Shallowest glide angle [degrees].
        max_angle: Steepest glide angle [degrees].
        volume: Volume pumped at each apogee [m^3].
        pump_efficiency: Efficiency of the pump.
        hotel: Hotel load [W].
        thrust: Power of a propeller at 1 m/s [W]; it scales with the cube of the speed.
        max_depth: Largest depth [m].
        speed_spread: Relative standard deviation of the speed between dives.
        speed_error: Relative standard error of the mean speed.
    """

    speed: float = 0.3
    flight: SteadyFlight | None = None
    min_angle: float = 15.0
    max_angle: float = 35.0
    volume: float = 4.6e-4
    pump_efficiency: float = 0.5
    hotel: float = 1.0
    thrust: float = 0.0
    max_depth: float = inf
    # of what its flight is made of they change nothing
    speed_spread: float = field(default=0.0, compare=False)
    speed_error: float = field(default=0.0, compare=False)

    def __post_init__(self) -> None:
        """Raise PlanError for inconsistent limits."""
        shallowest = 0.0 if self.flight is None else float(np.rad2deg(self.flight.shallowest))
        if not shallowest < self.min_angle <= self.max_angle < 90.0:
            raise PlanError(
                f"glide angles from {self.min_angle:g} to {self.max_angle:g} degrees: expected more than {shallowest:.1f}, increasing, "
                "less than 90"
            )
        for name in ("speed", "pump_efficiency", "hotel", "max_depth"):
            if not (value := getattr(self, name)) > 0.0:
                raise PlanError(f"a glider's {name} is {value!r}; expected a number above 0")
        if not (self.volume >= 0.0 and self.thrust >= 0.0 and self.volume + self.thrust > 0.0):
            raise PlanError(
                f"a glider's volume is {self.volume!r} and its thrust {self.thrust!r}; expected 0 or more, and one of them above 0"
            )

    @property
    def angles(self) -> tuple[float, float]:
        """Shallowest and steepest glide angle [rad]."""
        return float(np.deg2rad(self.min_angle)), float(np.deg2rad(self.max_angle))

    def speeds(self, maths: Any, glide_angle: Any) -> tuple[Any, Any]:
        """Return the horizontal and vertical speed through water [m/s] at a glide angle [rad], both positive."""
        speed = self.speed if self.flight is None else self.flight.speed(maths, glide_angle)
        return speed * maths.cos(glide_angle), speed * maths.sin(glide_angle)

    def paces(self, count: int, dive: int) -> Array:
        """Return the speed of a dive relative to ``speed`` in each flight, from error quantiles in fixed random orders.

        Args:
            count: Number of flights.
            dive: Number of the dive, from 0; ``speed_error`` is common to all dives, ``speed_spread`` is not.
        """
        normal = NormalDist()
        quantiles = np.array([normal.inv_cdf((k + 0.5) / count) for k in range(count)])
        alike, each_dive = (
            np.random.default_rng((count, k)).permutation(quantiles) for k in (0, dive + 1)
        )
        return np.asarray(
            np.maximum(1.0 + self.speed_error * alike + self.speed_spread * each_dive, 0.0)
        )

    def pitch(self, glide_angle: Array) -> Array:
        """Return the pitch below the horizontal of a dive at a glide angle [rad]; equal to it without a flight model."""
        return (
            glide_angle
            if self.flight is None
            else glide_angle - np.asarray(self.flight.angle_of_attack(np, glide_angle))
        )

    def pump_work(self, depth: Any) -> Any:
        """Return the energy of the pump at one apogee [J] for a depth [m]."""
        return DENSITY * GRAVITY * depth * self.volume / self.pump_efficiency

    @property
    def power(self) -> float:
        """Power under water without the pump [W]; propulsion scales with the cube of the speed."""
        return self.hotel + self.thrust * self.speed**3

    def energy(self, duration: Any, apogees: Any, drift: Any = 0.0) -> Any:
        """Return the energy [J] of a flight.

        Args:
            duration: [s].
            apogees: Summed apogee depth [m].
            drift: Part of the duration at the surface [s], where a propeller rests.
        """
        under_water = self.power * (duration - drift)
        return under_water + self.hotel * drift + self.pump_work(apogees)


def fit_flight(first: SteadyFlight, pitch: Array, depth_rate: Array) -> SteadyFlight:
    """Return a flight model with drag and lift fitted to measured vertical speeds.

    Args:
        first: Volume, area and induced drag, with initial guesses of drag and lift.
        pitch: Pitch below the horizontal in dives, above it in climbs, shape (n,) [rad], positive.
        depth_rate: Magnitude of the vertical speed at each pitch, shape (n,) [m/s].

    Raises:
        PlanError: Fewer than three values, values that are not positive, or equal pitches.
    """
    usable = all(
        bool(np.all(np.isfinite(values) & (values > 0.0))) for values in (pitch, depth_rate)
    )
    if pitch.shape != depth_rate.shape or pitch.size < 3 or not usable:
        raise PlanError(
            f"a fit of steady flight got {pitch.size} pitches and {depth_rate.size} depth rates, not all of them positive numbers; "
            "expected as many of each, three or more, all positive"
        )
    if np.ptp(pitch) < np.deg2rad(2.0):
        raise PlanError(
            f"pitches from {np.rad2deg(pitch.min()):.2f} to {np.rad2deg(pitch.max()):.2f} degrees do not separate drag from lift"
        )

    from scipy.optimize import least_squares  # loads slowly, and no plan fits a flight

    def model(unknowns: Array) -> SteadyFlight:
        return replace(first, drag=float(np.exp(unknowns[0])), lift=float(np.exp(unknowns[1])))

    def misfit(unknowns: Array) -> Array:
        flight = model(unknowns)
        glide_angle = angle_of_pitch(flight, pitch)
        return np.asarray(flight.speed(np, glide_angle) * np.sin(glide_angle) - depth_rate)

    return model(least_squares(misfit, np.log([first.drag, first.lift]), x_scale=0.1).x)


def angle_of_pitch(flight: SteadyFlight, pitch: Array) -> Array:
    """Return the glide angles of pitches [rad], by bisection."""
    low = np.full(pitch.shape, flight.shallowest + 1e-9)
    high = np.full(pitch.shape, np.pi / 2 - 1e-9)
    for _ in range(60):
        middle = 0.5 * (low + high)
        too_flat = middle - np.asarray(flight.angle_of_attack(np, middle)) < pitch
        low, high = np.where(too_flat, middle, low), np.where(too_flat, high, middle)
    return np.asarray(0.5 * (low + high))
