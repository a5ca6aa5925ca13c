"""Oscillations and the instrument's biases: how they turn, what they look like, and whether they are found."""

from dataclasses import replace

import numpy as np
import pytest

from replay_kit.config.estimation import TimeConfig
from replay_kit.core.geodesy import rotate_to_geographic, to_geographic
from replay_kit.estimator.evolving.build import build_evolving, state_space
from replay_kit.estimator.evolving.observation_operator import EARTH_ROTATION, oscillations
from tests.estimator.evolving.test_evolving import CONFIG, DAY, forecasts, profiles
from tests.estimator.update.test_path_mean import dive
from tests.reference import evolving as slow

LEVELS_END = 220.0
HOUR = 3600 * 10**9


@pytest.mark.parametrize("latitude", [-40.0, 40.0])
def test_an_inertial_current_turns_clockwise_in_the_north_only_and_once_in_its_period(latitude):
    swinging = oscillations(TimeConfig(oscillators=("inertial",)), latitude, LEVELS_END)
    f = 2 * EARTH_ROTATION * np.sin(np.deg2rad(latitude))
    operator = replace(
        build_evolving(forecasts(1), CONFIG, TimeConfig()).operator, oscillations=swinging
    )
    order = state_space(operator, TimeConfig(oscillators=("inertial",), oscillator_scale=1e18))
    n, k = swinging.knots.size, order.parts["oscillations"].start
    state = np.zeros(order.size)
    state[k] = 1.0  # eastward at the first knot's direction
    period = 2 * np.pi / abs(f)
    quarter = order.predict_mean(state, period / 4)
    east, north = quarter[k], quarter[k + n]
    assert abs(east) < 1e-9
    assert north == pytest.approx(-np.sign(latitude))
    np.testing.assert_allclose(order.predict_mean(state, period)[k], 1.0, atol=1e-9)
    both = order.predict_mean(np.arange(order.size, dtype=np.float64), 5000.0)
    pairs = np.column_stack(
        [np.arange(order.size)[k : k + n], np.arange(order.size)[k + n : k + 2 * n]]
    ).astype(float)
    np.testing.assert_allclose(
        np.column_stack([both[k : k + n], both[k + n : k + 2 * n]]),
        slow.turned(pairs, f, 5000.0),
        rtol=1e-9,
    )


def test_what_a_row_sees_at_another_time_is_what_the_turned_state_shows_now():
    config = TimeConfig(oscillators=("inertial", "M2"), oscillator_scale=1e18)
    estimator = build_evolving(forecasts(1), CONFIG, config)
    swinging, part = estimator.operator.oscillations, estimator.state_space.parts["oscillations"]
    rng = np.random.default_rng(3)
    state, rows = (
        rng.standard_normal(estimator.state_space.size),
        rng.standard_normal(swinging.size),
    )
    for seconds in (-7200.0, 0.0, 3600.0):
        later = estimator.state_space.rotated(state, seconds)
        assert swinging.at(rows[None], np.array([seconds]))[0] @ state[part] == pytest.approx(
            rows @ later[part], rel=1e-10
        )


@pytest.mark.parametrize("latitude_sign", [1.0, -1.0])
def test_a_mean_along_a_path_sees_an_oscillation_at_each_point_s_own_time(latitude_sign):
    """The state is of the path's end, and the oscillation went before it: by hand, with the complex exponential."""
    estimator = build_evolving(
        forecasts(1), CONFIG, TimeConfig(oscillators=("inertial",), oscillator_scale=1e18)
    )
    swinging = estimator.operator.oscillations
    swinging = replace(swinging, omega=latitude_sign * np.abs(swinging.omega))
    model = replace(estimator.operator, oscillations=swinging)
    path = dive()
    assert path.path_time_ns[0] < path.path_time_ns[-1] == path.time_ns
    east, north = np.random.default_rng(1).standard_normal((2, swinging.knots.size))
    state = np.zeros(estimator.state_space.size)
    state[estimator.state_space.parts["oscillations"]] = np.concatenate([east, north])
    seen = model.path(path, np.arange(1))
    expected = np.zeros(2)
    for depth, weight, time_ns in zip(path.depth, path.weight, path.path_time_ns, strict=True):
        # clockwise for a positive omega
        z = (
            swinging.root
            @ (east + 1j * north)
            * np.exp(-1j * swinging.omega[0] * (time_ns - path.time_ns) / 1e9)
        )
        at = np.interp(depth, swinging.knots, z.real) + 1j * np.interp(
            depth, swinging.knots, z.imag
        )
        expected += weight * np.array([at.real, at.imag])
    np.testing.assert_allclose(seen.design @ state * seen.stack.layouts[0].std, expected, rtol=1e-9)


def oscillating_profiles(n, omega, amplitude=0.3, hours=2.0, tidal=False):
    """Profiles of a current uniform in space that turns clockwise, or swings along the north-east, stronger above."""
    out = []
    for k, observation in enumerate(profiles(n, days=n * hours / 24.0)):
        t = observation.time_ns / 1e9
        strength = amplitude * np.exp(-observation.depth / 150.0)
        angle = omega * t
        vector = (
            np.array([np.cos(angle), np.cos(angle)])
            if tidal
            else np.array([np.cos(angle), -np.sin(angle)])
        )
        noise = 0.02 * np.random.default_rng(k).standard_normal((observation.depth.size, 2))
        out.append(
            replace(
                observation,
                velocity=strength[:, None] * vector + noise,
                error_std=np.full(observation.depth.size, 0.02),
            )
        )
    return out


def nothing_else():
    """A forecast without any current to speak of."""
    (only,) = forecasts(1)
    return [replace(only, velocity=1e-3 * only.velocity, time_ns=0)]


@pytest.mark.parametrize("kind", ["inertial", "M2"])
def test_an_oscillation_is_predicted_where_it_is_asked_for(kind):
    latitude = forecasts(1)[0].grid.projection.latitude
    omega = (
        2 * EARTH_ROTATION * np.sin(np.deg2rad(latitude))
        if kind == "inertial"
        else np.deg2rad(28.9841042) / 3600.0
    )
    log = oscillating_profiles(24, omega, tidal=kind == "M2")
    errors = {}
    for name, config in (
        ("with", TimeConfig(oscillators=(kind,))),
        ("without", TimeConfig(scale=86_400.0)),
    ):
        estimator = build_evolving(nothing_else(), CONFIG, config)
        state = estimator.initial()
        misfits = []
        for k, observation in enumerate(log):
            if k >= 12:
                misfits.append(estimator.innovation(state, observation))
            state, _ = estimator.step(state, observation)
        errors[name] = np.sqrt(np.nanmean(np.square(misfits)))
    assert errors["with"] < 0.4 * errors["without"]


def faulty(observation, heading_deg, scale, through_water, common_std=0.02):
    """The profile as an instrument with faults makes it: relative velocity turned and stretched, then the platform's velocity added."""
    relative = observation.velocity - through_water
    angle = np.deg2rad(heading_deg)
    turned = relative @ np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return replace(
        observation,
        velocity=(1.0 + scale) * turned + through_water,
        platform_velocity=(float(through_water[0]), float(through_water[1])),
        common_std=common_std,
    )


def test_biases_are_found_with_their_sign_and_size():
    estimator = build_evolving(
        forecasts(1), CONFIG, TimeConfig(scale="static", biases=("heading", "scale"))
    )
    grid, flow = forecasts(1)[0].grid, estimator.flow(estimator.initial())
    rng = np.random.default_rng(2)
    state = estimator.initial()
    for k, observation in enumerate(profiles(80)):
        place = (
            rng.uniform(0.8 * grid.east.min(), 0.8 * grid.east.max()),
            rng.uniform(0.8 * grid.north.min(), 0.8 * grid.north.max()),
        )
        longitude, latitude = to_geographic(grid.projection, *place)
        u, v = rotate_to_geographic(
            grid.projection, longitude, latitude, *flow.velocity(*place, observation.depth).T
        )
        angle = rng.uniform(0, 2 * np.pi)
        through_water = 0.3 * np.array([np.cos(angle), np.sin(angle)])
        truth = np.column_stack([u, v]) + 0.05 * rng.standard_normal((observation.depth.size, 2))
        sound = replace(
            observation,
            longitude=float(longitude),
            latitude=float(latitude),
            velocity=truth,
            time_ns=k * HOUR,
        )
        state, _ = estimator.step(state, faulty(sound, 5.0, 0.03, through_water))
    found = estimator.biases(state)
    heading, heading_std = found["heading"]
    scale, scale_std = found["scale"]
    assert np.rad2deg(heading) == pytest.approx(5.0, abs=3 * np.rad2deg(heading_std))
    assert heading > 5 * heading_std
    assert scale == pytest.approx(0.03, abs=3 * scale_std)
    # the currents' own part of what was turned is not in the mean relative velocity of a state that knows nothing of it
    assert np.rad2deg(heading_std) < 1.5


def test_what_is_off_costs_nothing():
    plain, all_off = (
        build_evolving(forecasts(), CONFIG, config)
        for config in (TimeConfig(), TimeConfig(oscillators=(), biases=()))
    )
    assert plain.state_space.size == all_off.state_space.size == plain.operator.process.size


def test_the_oscillations_prior_is_as_strong_as_asked_at_all_depths():
    swinging = oscillations(
        TimeConfig(oscillators=("inertial", "K1"), oscillator_std=0.07), 30.0, 300.0
    )
    depth = np.linspace(0.0, 300.0, 25)
    for component in range(2):
        std = np.sqrt(np.sum((swinging.weights(depth) @ swinging.factor(component)) ** 2, axis=1))
        # two oscillations; between knots a linear one is a little weaker
        assert np.all((std > 0.07 * np.sqrt(2) * 0.9) & (std < 0.07 * np.sqrt(2) * 1.01))
    assert DAY


@pytest.mark.parametrize(
    ("deepest", "count"), [(10.0, 2), (50.0, 2), (50.1, 3), (100.0, 3), (260.0, 7)]
)
def test_knots_are_as_few_as_are_half_a_depth_length_apart(deepest, count):
    config = TimeConfig(oscillators=("inertial",), oscillator_depth_length=100.0)
    np.testing.assert_allclose(
        oscillations(config, 30.0, deepest).knots, np.linspace(0.0, deepest, count)
    )
    assert oscillations(TimeConfig(), 30.0, deepest).knots.size == 0
