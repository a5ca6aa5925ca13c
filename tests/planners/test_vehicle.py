"""Steady flight, energy, the fit of a flight model to a log, and limits of the vehicle that each planner refuses to break."""

import numpy as np
import pytest

from planners import Glider
from planners.vehicle import DENSITY, GRAVITY, SteadyFlight, angle_of_pitch, fit_flight
from replay_kit.core.errors import PlanError

ANGLES = np.deg2rad(np.linspace(13.0, 60.0, 9))


def test_forces_balance_in_steady_flight():
    flight = SteadyFlight()
    attack, speed = flight.angle_of_attack(np, ANGLES), flight.speed(np, ANGLES)
    pressure = 0.5 * DENSITY * speed**2 * flight.area
    buoyancy = DENSITY * GRAVITY * flight.volume
    np.testing.assert_allclose(
        pressure * (flight.drag + flight.induced_drag * attack**2),
        buoyancy * np.sin(ANGLES),
        rtol=1e-12,
    )
    np.testing.assert_allclose(
        pressure * flight.lift * attack, buoyancy * np.cos(ANGLES), rtol=1e-12
    )
    assert np.all((speed > 0.2) & (speed < 0.6))
    # hull 2.4 and wings 3.7 per radian (Merckelbach et al. 2010): 3 degrees of attack in a glide of 26
    assert np.rad2deg(flight.angle_of_attack(np, np.deg2rad(26.0))) == pytest.approx(3.0, abs=0.1)


def test_a_fit_finds_the_flight_again():
    truth = SteadyFlight(drag=0.17, lift=5.2)
    glide = np.deg2rad(np.linspace(16.0, 40.0, 40))
    pitch = glide - truth.angle_of_attack(np, glide)
    rate = truth.speed(np, glide) * np.sin(glide)
    np.testing.assert_allclose(angle_of_pitch(truth, pitch), glide, rtol=1e-9)
    found = fit_flight(SteadyFlight(), pitch, rate)
    assert (found.drag, found.lift) == pytest.approx((0.17, 5.2), rel=1e-4)
    for pitches, rates in (
        (pitch[:2], rate[:2]),
        (pitch, rate[:-1]),
        (-pitch, rate),
        (pitch[:1] + np.zeros(5), rate[:5]),
    ):
        with pytest.raises(PlanError, match=r"positive|not separate"):
            fit_flight(SteadyFlight(), pitches, rates)


def test_energy_is_pump_work_and_hotel_load():
    glider = Glider(volume=5e-4, pump_efficiency=0.5, hotel=2.0)
    assert glider.pump_work(1000.0) == pytest.approx(1025.0 * 9.81 * 1000.0 * 5e-4 / 0.5)
    assert glider.energy(3600.0, 1500.0) == pytest.approx(7200.0 + 1.5 * glider.pump_work(1000.0))


def test_the_speed_of_dives_errs_by_what_they_show_and_less_in_the_mean_of_many():
    glider = Glider(speed_spread=0.1, speed_error=0.03)
    each = np.array([glider.paces(400, dive) for dive in range(100)])
    for paces, std in ((each[7], np.hypot(0.1, 0.03)), (each.mean(axis=0), np.hypot(0.01, 0.03))):
        assert paces.mean() == pytest.approx(1.0)
        assert paces.std() == pytest.approx(std, rel=0.1)
    np.testing.assert_array_equal(Glider().paces(5, 3), 1.0)
    assert glider == Glider()
