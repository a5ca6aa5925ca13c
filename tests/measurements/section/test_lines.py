"""Samples of a CTD to measurements of the shear: as they come, with faults, with turns, and in the estimate."""

import gsw
import numpy as np
import pytest

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.geodesy import to_geographic
from replay_kit.core.grid import Projection
from replay_kit.core.observation import LinearMeasurement
from tests.measurements.samples import counted, fix, logged, only, reasons, run
from tests.measurements.section.test_thermal_wind import LATITUDE, expected, water

CONFIG = MeasurementConfig()
START_NS = 1_700_000_000 * 10**9


def mission(
    dives=14, spacing=4e3, tilt=1e-3, latitude=LATITUDE, turn=99, change=lambda ctd, dive: ctd
):
    """Return the messages of dives to 800 m in water whose isopycnals rise to the east; from dive ``turn`` on the way goes north."""
    messages, place = [], np.zeros(2)

    def put(hours, message):
        time_ns = START_NS + int(hours * 3600.0) * 10**9
        messages.append(message._replace(time_ns=time_ns, position=len(messages)))

    def fixed(hours, at, depth, reckoned):
        longitude, north = to_geographic(Projection(-60.0, latitude), *at)
        metadata = {"depth": depth, "dead_reckoned": reckoned}
        put(hours, fix(0, float(longitude), float(north), metadata=metadata))

    rng = np.random.default_rng(1)
    for dive in range(dives):
        unit = np.array([0.0, 1.0] if dive >= turn else [1.0, 0.0])
        fixed(4 * dive, place, 0.0, False)
        share, (down, up) = np.linspace(0.004, 0.996, 250), 3.0 * rng.standard_normal(2)
        depth = 800.0 * (1.0 - np.abs(2.0 * share - 1.0))
        at = place + share[:, None] * spacing * unit
        heave = np.where(share > 0.5, up, down) * np.sin(np.pi * depth / 800.0)
        temperature, pressure = water(depth, depth + tilt * at[:, 0] + heave, -60.0, latitude)
        columns = {"depth": depth, "temperature": temperature, "pressure": pressure}
        for k, row in enumerate(np.transpose([*columns.values()]).tolist()):
            hours = 4 * dive + 3.8 * share[k]
            if round(share[k] * 250) % 10 == 1:
                fixed(hours, at[k], row[0], True)
            ctd = dict(zip(columns, row, strict=True)) | {"salinity": 35.0, "conductivity": None}
            put(hours, logged("replay_kit.Ctd", change(ctd, dive), topic="/ctd"))
        place = place + spacing * unit
    fixed(4 * dives, place, 0.0, False)
    return messages


def measured(messages, config=CONFIG):
    """Return the shears, the reasons by number of messages, and how many messages of the CTD were used."""
    events = run(messages, config)
    given = sum(message.topic == "/ctd" for message in messages)
    assert counted(events, "/ctd") == given
    said = reasons(events)
    return only(LinearMeasurement, events), set(said), given - len(said)


def test_dives_along_a_line_give_the_shear_across_it_once_it_is_long_enough():
    dives = mission(change=lambda ctd, dive: ctd | {"dive": 11 + dive})
    shears, reasons, used = measured(dives)
    first = shears[0]
    truth = expected(1e-3)[(first.depth / 10.0).astype(int)]
    relative = first.value[:, 0] - first.value[:, 0].mean() - (truth - truth.mean())
    assert np.sign(first.components[0, 1]) == 1.0
    assert np.abs(relative).max() < min(2.0 * first.error_std.max(), 0.3 * np.ptp(truth))
    assert (first.reference, first.source.topic) == ("relative", "/ctd")
    # of the last of its dives, as the vehicle numbers them
    assert (first.label.kind, first.label.doubt, first.label.dive) == ("shear", "", 16)
    # known at a surfacing, of dives that count in no other
    assert len({each.time_ns for each in shears}) == len(shears)
    assert used >= 250 * 8
    # after the message at which the line was complete, before the mission ended
    assert first.time_ns < dives[-1].time_ns
    assert reasons <= {"profiles along no straight line of 0.3 Rossby radii"}


def test_a_turn_ends_a_line():
    shears, _, _ = measured(mission(10, turn=5))
    directions = {round(float(abs(each.components[0, 1])), 1) for each in shears}
    assert directions == {1.0, 0.0}


def _mixed_to(bottom, noise=0.0):
    """Return what makes water the same down to a depth, but for noise of the instrument."""
    rng = np.random.default_rng(2)

    def change(ctd, dive):
        del dive
        if ctd["depth"] > bottom:
            return ctd
        pressure = ctd["pressure"]
        salinity = gsw.SA_from_SP(35.0, pressure, -60.0, LATITUDE)
        warm = float(gsw.t_from_CT(salinity, 10.0, pressure)) + noise * rng.standard_normal()
        return ctd | {"temperature": warm}

    return change


@pytest.mark.parametrize(
    "change",
    [
        _mixed_to(500.0),
        # few levels; all casts alike, over a gradient that internal waves would show in
        lambda ctd, _: ctd | {"temperature": np.nan if ctd["depth"] > 90.0 else ctd["temperature"]},
        lambda ctd, _: ctd | {"temperature": 10.0 - 0.005 * ctd["depth"]},
    ],
)
def test_water_that_is_hardly_stratified_gives_no_malformed_shear(change):
    shears, _, _ = measured(mission(9, change=change))
    assert shears
    assert all(np.isfinite(each.value).all() and (each.error_std > 0.0).all() for each in shears)
    assert all(np.isfinite(each.correlation).all() for each in shears)


def _in_ms_cm(ctd, dive):
    return ctd | {"salinity": float(gsw.C_from_SP(35.0, ctd["temperature"], ctd["pressure"]))}


def _conductivity(ctd, dive):
    return ctd | {"conductivity": _in_ms_cm(ctd, dive)["salinity"], "salinity": None}


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ({"change": _in_ms_cm}, "it looks like conductivity in mS/cm"),
        ({"change": _conductivity}, "it looks like mS/cm"),
        ({"change": lambda ctd, _: ctd | {"pressure": 0.1 * ctd["pressure"]}}, "it looks like bar"),
        (
            {"change": lambda ctd, _: ctd | {"pressure": 0.1 * ctd["pressure"], "depth": None}},
            "looks like bar",
        ),
        (
            {"change": lambda ctd, dive: ctd | {"salinity": 35.0 - 0.05 * dive}},
            "it looks like a fouled cell",
        ),
        ({"change": _mixed_to(900.0, 1e-4)}, "mixed water"),
        ({"config": MeasurementConfig(without=("shear",))}, "left out: shear"),
        ({"dives": 6, "spacing": 30e3, "latitude": 3.0}, "of the equator"),
    ],
)
def test_what_gives_no_shear_says_why(how, words):
    how = {"dives": 5, "config": CONFIG} | how
    config = how.pop("config")
    shears, reasons, used = measured(mission(**how), config)
    assert (shears, used) == ([], 0)
    assert any(words in reason for reason in reasons), reasons


@pytest.mark.full
def test_a_lag_of_the_cell_is_named_beside_the_shear():
    last = [10.0]

    def lagging(ctd, dive):
        behind = ctd["temperature"] - last[0]
        last[0] += 0.3 * behind
        return ctd | {"salinity": 35.0 + 0.4 * behind}

    shears, _, _ = measured(mission(change=lagging))
    assert shears
    assert all("lag" in each.label.doubt for each in shears)
    sound, _, _ = measured(mission())
    assert shears[0].error_std.max() > sound[0].error_std.max()


def test_a_conductivity_gives_the_salinity():
    def stated(ctd, dive):
        in_ms_cm = _conductivity(ctd, dive)
        return in_ms_cm | {"conductivity": 0.1 * in_ms_cm["conductivity"]}

    (first,), _, _ = measured(mission(5, change=stated))
    (same,), _, _ = measured(mission(5))
    np.testing.assert_allclose(first.value, same.value, atol=0.003)
