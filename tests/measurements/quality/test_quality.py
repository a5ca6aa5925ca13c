"""The quality tests of a ping: what each field does to its bins, and that a field that is absent or broken does nothing."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.observation import Flag, Observation, Reason
from replay_kit.measurements.observed import blocks, observation
from replay_kit.measurements.profiles import frames
from replay_kit.measurements.profiles.qartod import outlyingness
from tests.measurements.samples import fix, in_order, only, ping, run
from tests.reference import frames as slow
from tests.reference import quality as obvious

GOOD, SUSPECT, FAIL = Flag.GOOD, Flag.SUSPECT, Flag.FAIL
VECTORS = slow.janus_vectors(20.0)
BEAM = {
    "coordinate_system": "beam",
    "attitude_convention": "teledyne",
    "heading": 0.0,
    "pitch": 0.0,
    "roll": 0.0,
    "beam_unit_vectors": VECTORS.tolist(),
    "declination_applied": True,
    "bin_mapped": True,
}
SOUND = {"n_cells": 6, "cell_size": 4.0, "bin0_distance": 4.0, "velocity": [[0.1, 0.2, 0.0]] * 6}


def observed(config=None, depth=0.0, **changes):
    """Return the observation and the tests by name of one ping of six sound cells with changes."""
    messages = [fix(0, depth=depth), ping(0, **{**SOUND, **changes})]
    return found_of(messages, config or MeasurementConfig())


def found_of(messages, config):
    """Return the only observation of some messages and its tests by name."""
    (block,) = (one for one in blocks(messages, config) if one.ping)
    assert len(block.ping["time"]) == 1
    tests = {
        test.name: SimpleNamespace(flags=test.flags[0], why_not=test.why_not[0])
        for test in block.tests
    }
    return observation(block, 0), tests


def third(value, sound):
    """Return six cells of which the third is another."""
    return [value if k == 2 else sound for k in range(6)]


def beams(value):
    return third([90.0, 90.0, value, value], [90.0] * 4)


def test_a_ping_with_nothing_but_velocities_is_good_and_says_what_was_not_tested():
    observation, tests = observed()
    assert observation.flags.tolist() == [GOOD] * 6
    untested = (
        "bottom correlation amplitude snr percent_good error_velocity tilt sidelobe at_surface"
    )
    assert {name for name, check in tests.items() if check.why_not} == {*untested.split()}
    assert all((tests[name].flags == Flag.NOT_EVALUATED).all() for name in untested.split())


CELL = [0.1, 0.2, 0.0]
NORTEK = {"attitude_convention": "nortek"}


@pytest.mark.parametrize(
    ("changes", "flag", "reason"),
    [
        ({"correlation": beams(20.0)}, FAIL, Reason.LOW_CORRELATION),
        ({"correlation": np.ravel(beams(20.0)).tolist()}, FAIL, Reason.LOW_CORRELATION),
        ({"correlation": beams(40.0), **NORTEK}, FAIL, Reason.LOW_CORRELATION),
        ({"correlation": beams(40.0)}, GOOD, 0),
        # one bad beam of four
        ({"correlation": third([90.0, 90.0, 90.0, 3.0], [90.0] * 4)}, GOOD, 0),
        ({"amplitude": beams(3.0)}, FAIL, Reason.LOW_AMPLITUDE),
        ({"snr": beams(2.0)}, FAIL, Reason.LOW_SNR),
        ({"amplitude": beams(35.0), "noise_floor": [30.0] * 3 + [34.0]}, SUSPECT, Reason.LOW_SNR),
        ({"percent_good": third(40, 90)}, SUSPECT, Reason.LOW_PERCENT_GOOD),
        ({"error_velocity": third(-0.9, 0)}, SUSPECT, Reason.ERROR_VELOCITY),
        ({"velocity": third([*CELL, 2.1], [*CELL, None])}, FAIL, Reason.ERROR_VELOCITY),
        ({"velocity": third([2.5, 2.5, 0.0], CELL)}, FAIL, Reason.HIGH_SPEED | Reason.OUTLIER),
        ({"velocity": third([0.6, 0.2, 0.0], CELL)}, SUSPECT, Reason.OUTLIER),
        ({"velocity": third([0.1, 1.2, 0.0], CELL)}, FAIL, Reason.OUTLIER),
        ({"velocity": third(None, CELL)}, Flag.MISSING, Reason.MISSING),
    ],
)
def test_one_bad_cell_is_marked_and_no_other(changes, flag, reason):
    observation, _ = observed(**changes)
    assert observation.flags.tolist() == third(flag, GOOD)
    assert observation.reasons.tolist() == third(reason, 0)


@pytest.mark.parametrize(("convention", "flags"), [({}, [GOOD] * 5 + [FAIL]), (NORTEK, [FAIL] * 6)])
def test_percent_good_counts_solutions_only_where_teledyne_turned_the_velocities(convention, flags):
    solutions = {"percent_good": [[10.0, 5.0, 5.0, 80.0]] * 5 + [[0.0, 0.0, 100.0, 0.0]]}
    assert observed(**solutions, **convention)[0].flags.tolist() == flags


LIMITS = st.tuples(st.floats(0.0, 90.0), st.floats(0.0, 90.0)).map(sorted)
CELL_OF = st.lists(st.one_of(st.floats(0.0, 100.0), st.just(np.nan)), min_size=5, max_size=5)
ANGLE = st.floats(-180.0, 180.0)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.lists(CELL_OF, min_size=6, max_size=6), st.integers(1, 5), LIMITS, LIMITS, ANGLE, ANGLE)
def test_third_best_beams_and_the_tilt_of_the_axis_are_held_against_limits(
    cells, number, least, most, pitch, roll
):
    beams = [cell[:number] for cell in cells]
    limits = dict(zip(("correlation_fail", "correlation_suspect"), least, strict=True))
    limits |= dict(zip(("tilt_suspect", "tilt_fail"), most, strict=True))
    config = MeasurementConfig(quality=limits)
    _, tests = observed(config, correlation=beams, pitch=pitch, roll=roll)
    worst = [obvious.graded(obvious.third_best(cell), *least[::-1], True) for cell in beams]
    assert tests["correlation"].flags.tolist() == worst
    if not np.isclose(tilt := obvious.tilt(pitch, roll), most).any():
        assert set(tests["tilt"].flags) == {obvious.graded(tilt, *most, False)}


@pytest.mark.parametrize(("pitch", "flag"), [(-16.0, SUSPECT), (40.0, FAIL), (None, GOOD)])
def test_a_tilted_ping(pitch, flag):
    assert observed(pitch=pitch, roll=0.0)[0].flags.tolist() == [flag] * 6


VELOCITY = st.tuples(st.one_of(st.floats(-3.0, 3.0), st.just(np.nan)), st.floats(-3.0, 3.0))


@settings(max_examples=60)
@given(
    st.lists(st.tuples(VELOCITY, st.floats(0.05, 0.5)), min_size=1, max_size=14), st.integers(5, 9)
)
def test_outliers_as_the_obvious_way_has_them(cells, window):
    velocity, floor = [cell for cell, _ in cells], [std for _, std in cells]
    found = outlyingness(np.array(velocity), np.array(floor), window)
    np.testing.assert_allclose(found, obvious.outlyingness(velocity, floor, window), rtol=1e-10)


def test_a_glider_leans_to_glide():
    observation, tests = observed(depth=200.0, pitch=-26.0, roll=5.0)
    assert observation.flags.tolist() == [GOOD] * 6
    assert "gliding" in tests["tilt"].why_not


def test_the_surface_spoils_what_looks_up():
    """Bins from 16 to 36 m above 40 m: their edges reach to 38 m, the side lobe begins at 37.6 m; at 33 degrees at 33.5 m."""
    up = {"orientation": "up", "pressure": None, "bin0_distance": 16.0}
    observation, _ = observed(depth=40.0, **up)
    assert observation.reasons.tolist() == [0, 0, 0, 0, 0, Reason.SIDELOBE]
    wider, _ = observed(depth=40.0, **up, beam_unit_vectors=slow.janus_vectors(33.0).tolist())
    assert wider.reasons.tolist() == [0, 0, 0, 0, Reason.SIDELOBE, Reason.SIDELOBE]
    off, _ = observed(MeasurementConfig(quality={"sidelobe": False}), depth=40.0, **up)
    assert off.flags.tolist() == [GOOD] * 6


@pytest.mark.parametrize(("config", "flag"), [({}, SUSPECT), ({"at_surface": "fail"}, FAIL)])
def test_pings_at_the_surface_are_suspect_of_vehicles_that_dive_only(config, flag):
    deep = ping(30, **{**SOUND, "pressure": 50.0})
    later = [ping(60, **SOUND), ping(70, **SOUND, derived=True)]
    fixes = fix(0, depth=0.0), fix(20, depth=50.0), fix(40, depth=0.0), fix(80, depth=0.0)
    messages = in_order(*fixes, ping(10, **SOUND), deep, *later)
    found = only(Observation, run(messages, MeasurementConfig(quality=config)))
    assert [one.flags.tolist() for one in found] == [
        [each] * 6 for each in (GOOD, GOOD, flag, GOOD)
    ]
    assert set(found[2].reasons.tolist()) == {Reason.AT_SURFACE}


def test_the_speed_of_a_relative_profile_says_nothing():
    _, tests = observed(reference="platform", velocity=[[4.0, 0.0, 0.0]] * 6)
    assert tests["speed"].why_not == "velocity is relative to the platform"


def test_suspect_bins_fail_where_they_are_not_wanted():
    strict = MeasurementConfig(quality={"use_suspect": False})
    observation, _ = observed(strict, percent_good=third(40, 90))
    assert observation.flags.tolist() == third(FAIL, GOOD)


@pytest.mark.parametrize("broken", [[1.0], "none", {"a": 1}, [["x"]] * 6, [[[1.0]]] * 6])
def test_a_field_that_is_broken_fails_no_bin(broken):
    names = ["correlation", "amplitude", "snr", "percent_good", "error_velocity"]
    assert observed(**dict.fromkeys(names, broken))[0].flags.tolist() == [GOOD] * 6


def test_a_solution_from_beams_brings_its_error_velocity():
    along, weights = np.tile(VECTORS @ [0.1, 0.2, 0.0], (6, 1)), frames.error_weights(VECTORS)
    along[3] += 1.5 * weights / (weights @ weights)
    along[4, 1] = np.nan
    observation, tests = observed(**BEAM, velocity=along.tolist())
    assert observation.reasons.tolist() == [0, 0, 0, Reason.ERROR_VELOCITY, 0, 0]
    assert tests["error_velocity"].flags[4] == Flag.NOT_EVALUATED


def test_every_test_can_be_switched_off():
    limits = {
        name
        for name in type(MeasurementConfig().quality).model_fields
        if name.endswith(("_suspect", "_fail"))
    }
    limits = dict.fromkeys(limits - {"use_suspect"})
    off = MeasurementConfig(quality=limits | {"sidelobe": False, "at_surface": "off"})
    bad = dict.fromkeys(("correlation", "amplitude", "percent_good"), [0.0] * 6)
    bad["velocity"] = [[0.1, 0.1, 0.0, 4.0], *[[0.1, 4.0, 0.0, 4.0]] * 5]
    observation, tests = observed(off, **bad, pitch=60.0, roll=0.0)
    assert observation.flags.tolist() == [GOOD] * 6
    said = {check.why_not for name, check in tests.items()}
    assert said - {""} == {"switched off", "no bottom track"}


def test_beams_percent_good_is_each_beam_s_also_where_gps_makes_the_ping_absolute_later():
    """A ping of beams turns to earth coordinates when it comes and to reference earth when its fixes are there: in two steps."""
    beam = {
        **SOUND,
        **BEAM,
        "reference": "platform",
        "velocity": np.tile(VECTORS @ [0.1, 0.2, 0.0], (6, 1)).tolist(),
        "percent_good": [[60, 5, 5, 60]] * 6,
    }
    fixes = [fix(k, 152.0 + 1e-5 * k) for k in range(120)]
    found, tests = found_of(in_order(*fixes, ping(60.5, **beam)), MeasurementConfig())
    assert found.reference == "earth"
    # the third best of four beams, not the sum of the first and fourth number
    assert tests["percent_good"].flags.tolist() == [FAIL] * 6
