"""Files of HF radars and drifters to messages: units, errors, depths, what is left out, and what is refused."""

import numpy as np
import pandas as pd
import pytest

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.errors import LogError
from replay_kit.core.observation import LinearMeasurement
from replay_kit.logs import merge, open_log, open_logs
from replay_kit.logs.netcdf import surface
from tests.logs import surface_samples as made
from tests.measurements.samples import Skipped, events_of

CURRENT = (0.15, -0.25)
NO_TIDE = MeasurementConfig(surface_tide_std=0.0, surface_spacing=10e3)
STRICT = NO_TIDE.model_copy(
    update={"quality": NO_TIDE.quality.model_copy(update={"use_suspect": False})}
)


def read(paths, config=NO_TIDE):
    logs = open_logs(paths)
    events = [event for each in events_of(merge(logs, 1.0), config) for event in each]
    notes = [note for log in logs for note in log.report().notes]
    return logs, [each for each in events if isinstance(each, LinearMeasurement)], events, notes


def payload(path):
    (message,) = open_log(path).messages()
    return message.payload


def test_totals_have_their_units_errors_and_depth(tmp_path, monkeypatch):
    whole = made.totals(CURRENT)
    paths = [tmp_path / f"{k}.nc" for k in range(3)]
    for k, path in enumerate(reversed(paths)):
        whole.isel(time=[k]).to_netcdf(path, engine="h5netcdf")
    (log,), found, _, notes = read(paths)
    assert log.format == "radar-totals"
    assert [each.time_ns for each in found] == whole.time.values.astype(int).tolist()
    first = found[0]
    np.testing.assert_allclose(first.value, np.tile(CURRENT, (len(first.value), 1)), atol=1e-6)
    # 13 MHz; normalised variance of 0.25 of 400 cm2/s2, over boxes of up to twelve vectors whose errors are correlated over 10 km
    assert first.depth[0] == pytest.approx(0.918, abs=1e-3)
    assert 0.05 < first.error_std.min() < 0.1
    assert first.error_std.max() <= 0.1 + 1e-9
    assert len(first.value) < 12 * 14 / 4
    assert any("times the signal's stated variance of 400 cm2/s2" in note for note in notes)
    # in one file, whose times are read two by two
    monkeypatch.setattr(surface, "_ROWS", 2)
    whole.to_netcdf(tmp_path / "one.nc", engine="h5netcdf")
    _, same, _, _ = read([tmp_path / "one.nc"])
    assert [each.value.tolist() for each in same] == [each.value.tolist() for each in found]


def test_two_stations_give_the_current_of_the_totals(tmp_path):
    for name, origin in (("west", (151.8, -39.8)), ("north", (152.2, -39.5))):
        made.write_radials(tmp_path / f"{name}.ruv", CURRENT, origin)
    (log,), found, _, notes = read([tmp_path / "west.ruv", tmp_path / "north.ruv"])
    assert log.format == "radar-radials"
    assert "MADE: 2 radials over land, not used" in notes
    components = np.concatenate([np.repeat(each.components, len(each.value), 0) for each in found])
    speeds = np.concatenate([each.value[:, 0] for each in found])
    solved = np.linalg.lstsq(components, speeds, rcond=None)[0]
    np.testing.assert_allclose(solved, CURRENT, atol=0.002)
    assert all(each.label.kind == "radar" for each in found)
    # each states 5 cm/s
    errors = np.concatenate([each.error_std for each in found])
    assert ((errors > 0.02) & (errors < 0.06)).all()


@pytest.mark.parametrize(
    ("flags", "bad", "by"),
    [
        ("PRIM", {"PRIM": 4}, "PRIM"),
        ("Q201 Q206", {"Q206": 4}, "Q201, Q206"),
        ("Q206 PRIM", {"PRIM": 9}, "PRIM"),
    ],
)
def test_radials_that_their_quality_flags_fail_are_not_used_and_suspect_ones_as_asked(
    tmp_path, flags, bad, by
):
    path, names = tmp_path / "one.ruv", f"LOND LATD VFLG ESPC ETMP RNGE BEAR VELO HEAD {flags}"

    def used(suspect, config=NO_TIDE):
        def change(k, row):
            row |= dict.fromkeys(flags.split(), 1) | ({"Q201": 2} if "Q201" in flags else {})
            if k % 4 == 1:
                return row | {"VELO": row["VELO"] + 120.0, **bad}
            return row | (dict.fromkeys(bad, 3) if k % 4 == 2 and suspect else {})

        made.write_radials(path, CURRENT, names=names, change=change)
        _, found, _, notes = read([path], config)
        assert f"MADE: 21 radials failed by their quality flags ({by}), not used" in notes
        assert max(np.abs(each.value).max() for each in found) < 0.35
        return sum(each.weights.size for each in found)

    assert used(True, STRICT) < used(True) == used(False)


def test_radials_of_phased_arrays_state_no_errors_and_no_flags(tmp_path):
    path = tmp_path / "one.ruv"
    made.write_radials(path, CURRENT, names="LOND LATD VELU VELV RNGE BEAR VELO HEAD")
    _, found, _, notes = read([path])
    assert found
    assert notes == ["MADE: radials state no error; 10 cm/s is assumed for each"]
    assert set(payload(path)["error"]) == {0.1}


@pytest.mark.parametrize(
    "names",
    [
        "u v dopx dopy qc",
        "EWCT NSCT EWCS NSCS QCflag",
        "UCUR VCUR UCUR_sd VCUR_sd UCUR_quality_control",
    ],
)
def test_totals_state_standard_errors_or_dilutions_of_precision(tmp_path, names):
    whole, dilutes = made.totals(CURRENT, hours=1), "dopx" in names
    whole["u_err"] = whole["v_err"] = 0.8 + 0.0 * whole.u_err
    whole["u_err"].attrs = whole["v_err"].attrs = {"units": "1" if dilutes else "cm/s"}
    whole["flag"] = 1.0 + 3.0 * (whole.lon < 152.05) + 0.0 * whole.v_err
    own = zip(("u", "v", "u_err", "v_err", "flag"), names.split(), strict=True)
    whole = whole.rename({old: new for old, new in own if old != new})
    if "UCUR" in names:
        # on a curvilinear grid
        lon, lat = ((("J", "I"), each) for each in np.meshgrid(whole.lon, whole.lat))
        whole = whole.drop_vars(["lon", "lat"]).rename_dims(lat="J", lon="I")
        whole = whole.assign(LONGITUDE=lon, LATITUDE=lat)
    whole.to_netcdf(path := tmp_path / "a.nc", engine="h5netcdf")
    assert set(np.round(payload(path)["east_error"], 9)) == {0.08 if dilutes else 0.008}
    assert payload(path)["north"] == pytest.approx([CURRENT[1]] * 144)


_FAILED, _SUSPECT = np.ones((2, 1, 1, 12, 14), np.int32)
_FAILED[..., 4:6], _SUSPECT[..., 8] = 4, 3
_OWN = {"flag_values": "0 1 2", "flag_meanings": "fine doubtful_suspect rejected"}


@pytest.mark.parametrize(
    "flags",
    [
        {"primary_flag": np.maximum(_FAILED, _SUSPECT)},
        {"qc": np.select([_FAILED == 4, _SUSPECT == 3], [2, 1], 0)},
        {"qc16_maxspeed": _FAILED, "qc18_validlocation": _SUSPECT},
        {"qc_primary_flag": np.maximum(_FAILED, _SUSPECT), "qc19_uerr": np.full_like(_FAILED, 4)},
    ],
)
def test_totals_that_their_quality_flags_fail_are_not_used(tmp_path, flags):
    path, whole = tmp_path / "one.nc", made.totals(CURRENT, hours=1)
    held = {name: (whole.u.dims, v, _OWN if name == "qc" else {}) for name, v in flags.items()}
    off = whole.assign(u=whole.u.where(_FAILED == 1, 150.0), **held)
    off.to_netcdf(path, engine="h5netcdf")
    _, found, _, notes = read([path])
    # of two columns of twelve, two vectors are missing or of questionable quality
    assert "24 vectors failed by their quality flags, not used" in notes
    for each in found:
        np.testing.assert_allclose(each.value, np.tile(CURRENT, (len(each.value), 1)), atol=1e-6)
    assert payload(path)["flag"].count(3.0) == 12


_WORDS = {
    1: "Minimum sites",
    2: "Minimum vectors",
    3: "Search window",
    4: "Decorrelation scales in the north direction",
    5: "Decorrelation scales in the east direction",
    6: "Signal variance of the surface current fields (cm2 s-2)",
}
_VALUES = [2.0, 3.0, 0.02, 10.0, 10.0, 400.0, 66.0]
_NUMBERED = {f"parameter{n}": _VALUES[n - 1] for n in _WORDS}
_NUMBERED |= {f"parameter{n}_description": words for n, words in _WORDS.items()}
_LISTED = {"comment": "\n".join(f"{n}) {words}" for n, words in _WORDS.items())}


@pytest.mark.parametrize("held", [((), 0.0, _NUMBERED), ("seven", _VALUES, _LISTED)])
def test_the_signals_variance_is_found_by_its_description(tmp_path, held):
    whole = made.totals(CURRENT, hours=1)
    whole["processing_parameters"] = held
    whole.to_netcdf(tmp_path / "one.nc", engine="h5netcdf")
    found = payload(tmp_path / "one.nc")
    assert found["east_error"][0] == pytest.approx(0.1)
    assert found["error_length"] == 10e3


def _radials(**change):
    def write(folder):
        made.write_radials(folder / "a.ruv", CURRENT, **change)

    return write


def _edited(write, edit):
    def edited(folder):
        write(folder)
        (path,) = folder.iterdir()
        path.write_text(edit(path.read_text()))

    return edited


def _without_variance(folder):
    totals = made.totals(CURRENT).drop_vars("processing_parameters")
    totals.to_netcdf(folder / "a.nc", engine="h5netcdf")


def _knots(k, row):
    return {"VELO": row["VELO"] / 51.44}


@pytest.mark.parametrize(
    ("write", "words"),
    [
        (
            _radials(change=lambda k, row: {"LOND": row["LOND"] + 0.5}),
            "another station: they lie 43",
        ),
        (_radials(unit="knots"), "expected speeds in cm/s, the file states .*knots"),
        (_radials(change=_knots), "they look like knots or m/s"),
        (_radials(names="LOND LATD VELO HEAD RNGE"), "it lacks BEAR"),
        (_edited(_radials(), lambda text: text.replace("%Origin", "%Place")), "it lacks Origin"),
        (
            _edited(_radials(), lambda text: text.replace("%Origin:  -", "%Origin:  -9")),
            "Origin: expected latitude and longitude",
        ),
        (_without_variance, "expected the signal's variance"),
        (
            _edited(lambda at: _table(made.drifters(), at / "a.csv"), lambda text: text[:-30]),
            "expected a table: names, perhaps units, rows as long",
        ),
    ],
)
def test_files_that_are_not_what_they_say_or_lack_something_are_refused(tmp_path, write, words):
    write(tmp_path)
    with pytest.raises(LogError, match=words):
        read([*tmp_path.iterdir()])


def _table(ds, path):
    """Write drifters as ERDDAP does: names, units, a row a fix; a drogue that is not lost has the calendar's first date."""
    count = ds["rowsize"].values
    of_each = {name: np.repeat(ds[name].values, count) for name in ("ID", "drogue_lost_date")}
    lost = of_each["drogue_lost_date"]
    lost[lost > np.datetime64("2019-01-20")] = 0
    table = pd.DataFrame({name: ds[name].values for name in ("time", "latitude", "longitude")})
    table = table.assign(**of_each, rowsize=count[0])
    units = {"time": "UTC", "drogue_lost_date": "UTC", "latitude": "degrees_north"}
    units = ",".join((units | {"longitude": "degrees_east"}).get(name, "") for name in table)
    names, *rows = table.to_csv(index=False, date_format="%Y-%m-%dT%H:%M:%SZ").splitlines()
    path.write_text("\n".join([names, units, *rows, ""]))


@pytest.mark.parametrize("suffix", ["nc", "csv"])
@pytest.mark.parametrize(("lost_after", "means"), [(5, 4), (99, 8)])
def test_drifters_give_the_current_at_their_drogues_until_they_lose_them(
    tmp_path, suffix, lost_after, means
):
    path, ds = tmp_path / f"drifters.{suffix}", made.drifters(lost_after=lost_after)
    if suffix == "csv":
        _table(ds, path)
    else:
        ds.to_netcdf(path, engine="h5netcdf")
    (log,), found, events, notes = read([path])
    assert log.format == "drifters"
    # a mean between each fix and the next, of the one drifter with its drogue
    assert len(found) == means
    for each in found:
        np.testing.assert_allclose(each.value, [[0.2, 0.0]], atol=0.003)
        assert each.value_depth == pytest.approx(15.0)
        assert each.error_std[0] == pytest.approx(np.hypot(0.01, 28.3 / 21600.0), rel=0.01)
    lost = [event for event in events if isinstance(event, Skipped)]
    assert {event.reason for event in lost} == {"drifter without its drogue: the wind moves it"}
    assert len(lost) == 18 - means - 1
    assert "depth of the drogues is not stated: 15 m taken" in notes
