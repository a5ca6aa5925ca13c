"""What an instrument repeats, its noise and its beams: named on what is wrong, and silent on what is sound."""

from dataclasses import replace

import numpy as np
import pytest

import replay_kit as rk
from replay_kit.core.message import Message
from replay_kit.core.observation import Flag, RawValues
from replay_kit.logs.mcap.writer import write_mcap_log
from replay_kit.measurements.consistency import findings
from replay_kit.measurements.consistency.raw import raw_values
from tests import synthetic
from tests.measurements.samples import checked, ping, profile, vehicle

CELLS, STEP_NS = 12, 600 * 10**9


def pings(number, noise=0.05, stated=0.05, seed=0, **raw):
    """Profiles of a diving vehicle whose current grows with depth, with the raw values of their bins."""
    rng = np.random.default_rng(seed)
    for k in range(number):
        depth = 60.0 * (k % 6) + 10.0 * np.arange(1.0, CELLS + 1.0)
        velocity = np.stack([0.1 + 1e-4 * depth, -5e-5 * depth], axis=1)
        velocity = velocity + noise * rng.standard_normal((CELLS, 2))
        raw_of = replace(*raw_values(velocity[None]), **raw)
        yield profile(velocity, depth, stated, k * STEP_NS, raw=raw_of)


def names(events):
    return [finding.name for finding in checked(events)[0].findings]


@pytest.mark.parametrize(
    ("stated", "named"),
    [(0.05, []), (0.01, []), (0.4, []), (0.005, [findings.ERRORS]), (5.0, [findings.ERRORS])],
)
def test_stated_errors_are_named_when_the_bins_scatter_otherwise(stated, named):
    assert names(pings(45, stated=stated)) == named


def test_correlated_errors_say_nothing_of_the_noise():
    assert names(replace(each, correlation_depth=30.0) for each in pings(45, stated=5.0)) == []


def stuck(noise, begin=10):
    rng, kept = np.random.default_rng(1), None
    for k, each in enumerate(pings(40)):
        if k < begin:
            kept = each.velocity
            yield each
        else:
            velocity = kept + noise * rng.standard_normal(kept.shape)
            yield replace(each, velocity=velocity, raw=raw_values(velocity[None])[0])


def test_an_instrument_that_repeats_one_shape_with_noise_is_named_with_the_time():
    (finding,) = checked(stuck(0.01))[0].findings
    assert (finding.name, finding.distrusts) == (findings.DEAD, True)
    assert 8 * STEP_NS <= finding.since_ns <= 12 * STEP_NS
    assert names(pings(40)) == []


def along_beams(change, number=4):
    rng = np.random.default_rng(2)
    for each in pings(40):
        beams = 0.05 * rng.standard_normal((CELLS, number))
        change(beams, rng)
        raw = RawValues("varied", b"", np.diff(beams, 2, axis=0), along_beams=True)
        yield replace(each, raw=raw)


def test_a_beam_that_is_noisy_or_dead_is_named_by_its_number():
    def noisy(beams, rng):
        beams[:, 2] += rng.standard_normal(CELLS)

    def dead(beams, rng):
        beams[:, 1] = 0.0

    for change, number in ((noisy, 3), (dead, 2)):
        (finding,) = checked(along_beams(change))[0].findings
        assert finding.name == findings.BEAM
        assert f"beam {number} scatters" in finding.evidence
    assert names(along_beams(lambda beams, rng: None)) == []


def test_an_instrument_with_another_number_of_beams_begins_anew():
    def dead(beams, rng):
        beams[:, 1] = 0.0

    sound, bad = ([*along_beams(how, number)] for how, number in ((lambda *_: None, 3), (dead, 4)))
    later = [replace(each, time_ns=each.time_ns + 40 * STEP_NS) for each in sound]
    state, used, _ = checked([*bad, *later])
    # what a bad one has shown says nothing of the sound one after it
    assert [each.name for each in state.findings] == [findings.BEAM]
    assert all((each.flags == Flag.GOOD).all() for each in used[-40:])


@pytest.mark.parametrize("beams", [[3] * 30 + [4] * 30, [3, 4] * 30], ids=["after", "in turn"])
def test_pings_of_three_and_of_four_beams_on_one_topic_are_all_used(tmp_path, beams):
    rng, messages = np.random.default_rng(0), []
    for k, number in enumerate(beams):
        time_ns, around = (1_542_330_000 + 60 * k) * 10**9, np.arange(number) * 2 * np.pi / number
        units = np.column_stack(
            [0.4 * np.sin(around), 0.4 * np.cos(around), np.full(number, -0.92)]
        )
        place = {"longitude": 152.1 + 0.003 * k, "latitude": -39.9 + 0.002 * k, "altitude": 0.0}
        velocity = rng.normal([0.1, 0.05, 0.0], 0.03, (CELLS, 3)) @ units.T
        held = ping(
            coordinate_system="beam",
            n_cells=CELLS,
            cell_size=8.0,
            velocity=velocity.tolist(),
            beam_unit_vectors=units.tolist(),
            attitude_convention="teledyne",
            **dict.fromkeys(("heading", "pitch", "roll"), 0.0),
            **dict.fromkeys(("declination_applied", "bin_mapped"), True),
        )
        messages += [
            Message(time_ns, "/fix", "foxglove.LocationFix", place, 0, 2 * k),
            held._replace(time_ns=time_ns + 1, position=2 * k + 1),
        ]
    write_mcap_log(tmp_path / "a.mcap", messages)
    dataset = synthetic.dataset(n_members=6).assign_coords(time=np.datetime64("2018-11-16", "ns"))
    settings = {"estimator": {"modes": 4, "shift_distance": 0.0}, "time": {"scale": "static"}}
    result = rk.replay(tmp_path / "a.mcap", dataset, settings=settings)
    assert result.outcome.observations["used"] == 60
    assert not result.summary.findings


@pytest.mark.parametrize(("error", "named"), [(0.02, []), (0.3, [findings.BEAM])])
def test_beams_that_contradict_each_other_in_all_cells_are_named(error, named):
    def with_error():
        for each in along_beams(lambda beams, rng: None):
            yield replace(each, raw=replace(each.raw, error_velocity=error))

    assert names(with_error()) == named


def test_messages_that_come_twice_are_a_warning_and_those_of_two_logs_are_not():
    places = [vehicle(600.0 * k, 150.0 + 1e-3 * k) for k in range(40)]
    twice = [one for one in places for _ in range(2)]
    assert [(each.name, each.severity) for each in checked(twice)[0].findings] == [
        (findings.DUPLICATES, "warning")
    ]
    other = [one for k, one in enumerate(places) for one in (one, vehicle(600.0 * k, log=1))]
    assert findings.DUPLICATES not in names(other)
    assert names(places) == []
