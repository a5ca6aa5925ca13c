"""Files of HF radars and drifters to messages: units, errors, depths, what is left out, and what is refused."""

import numpy as np
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


def read(paths, config=NO_TIDE):
    logs = open_logs(paths)
    events = [event for each in events_of(merge(logs, 1.0), config) for event in each]
    notes = [note for log in logs for note in log.report().notes]
    return logs, [each for each in events if isinstance(each, LinearMeasurement)], events, notes


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
    whole.to_netcdf(tmp_path / "one.nc", engine="h5netcdf")
    # its times are read two by two
    monkeypatch.setattr(surface, "_ROWS", 2)
    _, same, _, _ = read([tmp_path / "one.nc"])
    assert [each.value.tolist() for each in same] == [each.value.tolist() for each in found]


def test_two_stations_give_the_current_of_the_totals(tmp_path):
    for name, origin in (("west", (151.8, -39.8)), ("north", (152.2, -39.5))):
        made.write_radials(tmp_path / f"{name}.ruv", CURRENT, origin)
    _, found, _, notes = read([tmp_path / "west.ruv", tmp_path / "north.ruv"])
    assert "MADE: 2 radials over land, not used" in notes
    components = np.concatenate([np.repeat(each.components, len(each.value), 0) for each in found])
    speeds = np.concatenate([each.value[:, 0] for each in found])
    solved = np.linalg.lstsq(components, speeds, rcond=None)[0]
    np.testing.assert_allclose(solved, CURRENT, atol=0.002)
    assert all(each.label.kind == "radar" for each in found)
    # each states 5 cm/s
    errors = np.concatenate([each.error_std for each in found])
    assert ((errors > 0.02) & (errors < 0.06)).all()


def _rewrite(path, names, columns):
    """Give a file of radials other columns: ``columns`` makes them of the number of the row and its values by name."""
    lines, had, k = [], [], 0
    for line in path.read_text().splitlines():
        if line.startswith("%TableColumnTypes:"):
            had, line = line.split()[1:], f"%TableColumnTypes: {names}"
        elif line[:1] == " ":
            row = columns(k, dict(zip(had, line.split(), strict=True)))
            line, k = " " + " ".join(str(row[name]) for name in names.split()), k + 1
        lines.append(line)
    path.write_text("\n".join(lines) + "\n")


@pytest.mark.parametrize(
    ("flags", "bad"),
    [("PRIM", {"PRIM": 4}), ("Q201 Q206", {"Q206": 4}), ("Q206 PRIM", {"PRIM": 9})],
)
def test_radials_that_their_quality_flags_fail_are_not_used_and_suspect_ones_as_asked(
    tmp_path, flags, bad
):
    path = tmp_path / "one.ruv"
    made.write_radials(path, CURRENT)
    sound, (_, found, _, _) = path.read_bytes(), read([path])

    def with_flags(suspect):
        def columns(k, row):
            row |= dict.fromkeys(flags.split(), 1) | ({"Q201": 2} if "Q201" in flags else {})
            if k % 4 == 1:
                row |= {"VELO": float(row["VELO"]) + 120.0, **bad}
            return row | ({next(iter(bad)): 3} if k % 4 == 2 and suspect else {})

        path.write_bytes(sound)
        _rewrite(path, f"LOND LATD VFLG ESPC ETMP RNGE BEAR VELO HEAD {flags}", columns)
        return path

    (log,), flagged, _, notes = read([with_flags(suspect=False)])
    tests = "PRIM" if "PRIM" in flags else "Q201, Q206"
    assert f"MADE: 21 radials failed by their quality flags ({tests}), not used" in notes
    assert len(flagged) == len(found)
    speeds = [np.abs(each.value).max() for each in flagged]
    assert max(speeds) < 0.35
    strict = NO_TIDE.model_copy(
        update={"quality": NO_TIDE.quality.model_copy(update={"use_suspect": False})}
    )
    fewer, all_of_them = (read([with_flags(True)], config)[1] for config in (strict, NO_TIDE))
    assert sum(v.weights.size for v in fewer) < sum(v.weights.size for v in all_of_them)
    assert log.format == "radar-radials"


def test_radials_of_phased_arrays_state_no_errors_and_no_flags(tmp_path):
    path = tmp_path / "one.ruv"
    made.write_radials(path, CURRENT)
    _, found, _, _ = read([path])
    _rewrite(path, "LOND LATD VELU VELV RNGE BEAR VELO HEAD", lambda k, row: row)
    _, same, _, notes = read([path])
    assert notes == ["MADE: radials state no error; 10 cm/s is assumed for each"]
    assert sum(len(each.value) for each in same) >= sum(len(each.value) for each in found)
    assert min(each.error_std.min() for each in same) > min(each.error_std.min() for each in found)
    (message,) = open_log(path).messages()
    assert set(message.payload["error"]) == {0.1}


def test_totals_that_their_quality_flags_fail_are_not_used(tmp_path):
    path, whole = tmp_path / "one.nc", made.totals(CURRENT, hours=1)
    good = np.ones(whole.u.shape, np.int32)
    failed, suspect = good.copy(), good.copy()
    failed[:, :, 4:6], suspect[:, :, 8] = 4, 3
    off = whole.assign(u=whole.u.where(failed == 1, 150.0))
    meanings = {"flag_values": "0 1 2", "flag_meanings": "fine doubtful_suspect rejected"}
    own = np.where(failed == 4, 2, np.where(suspect == 3, 1, 0))
    dims = off.u.dims
    for flags in (
        {"primary_flag": (dims, np.maximum(failed, suspect))},
        {"qc": (dims, own, meanings)},
        {"qc16_maxspeed": (dims, failed), "qc18_validlocation": (dims, suspect)},
        {"qc_primary_flag": (dims, np.maximum(failed, suspect)), "qc19_uerr": (dims, 4 * good)},
    ):
        off.assign(flags).to_netcdf(path, engine="h5netcdf")
        _, found, _, notes = read([path])
        assert "28 vectors failed by their quality flags, not used" in notes
        for each in found:
            np.testing.assert_allclose(
                each.value, np.tile(CURRENT, (len(each.value), 1)), atol=1e-6
            )
        (message,) = open_log(path).messages()
        assert message.payload["flag"].count(3.0) == 14


@pytest.mark.parametrize("form", ["attributes", "seven"])
def test_the_signals_variance_is_found_by_its_description(tmp_path, form):
    whole = made.totals(CURRENT, hours=1)
    words = [
        "Minimum sites",
        "Minimum vectors",
        "Search window",
        "Decorrelation scales in the north direction",
    ]
    words += [
        "Decorrelation scales in the east direction",
        "Signal variance of the surface current fields (cm2 s-2)",
    ]
    values = [2.0, 3.0, 0.02, 10.0, 10.0, 400.0, 66.0]
    if form == "attributes":
        whole["processing_parameters"] = ((), 0.0)
        numbered = list(enumerate(zip(values, words, strict=False), 1))
        whole.processing_parameters.attrs = {f"parameter{n}": value for n, (value, _) in numbered}
        whole.processing_parameters.attrs |= {
            f"parameter{n}_description": w for n, (_, w) in numbered
        }
    else:
        whole["processing_parameters"] = ("seven", values)
        listed = "\n".join(f"{n}) {word}" for n, word in enumerate(words, 1))
        whole.processing_parameters.attrs = {"comment": listed}
    whole.to_netcdf(tmp_path / "one.nc", engine="h5netcdf")
    (message,) = open_log(tmp_path / "one.nc").messages()
    assert message.payload["east_error"][0] == pytest.approx(0.1)
    assert message.payload["error_length"] == 10e3


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"moved": 0.5}, "radials of another station: they lie 43 km"),
        ({"unit": "knots"}, "expected speeds in cm/s, the file states .*knots"),
        ({"scale": 1.0 / 51.44}, "they look like knots or m/s"),
    ],
)
def test_radials_that_are_not_what_they_say_are_refused(tmp_path, change, words):
    made.write_radials(tmp_path / "one.ruv", CURRENT, **change)
    with pytest.raises(LogError, match=words):
        read([tmp_path / "one.ruv"])


def test_a_file_that_lacks_a_key_or_a_variance_is_refused(tmp_path):
    path = tmp_path / "one.ruv"
    made.write_radials(path, CURRENT)
    path.write_text(path.read_text().replace("%Origin", "%Place"))
    with pytest.raises(LogError, match="it lacks Origin"):
        open_logs([path])
    totals = made.totals(CURRENT).drop_vars("processing_parameters")
    totals.to_netcdf(tmp_path / "totals.nc", engine="h5netcdf")
    with pytest.raises(LogError, match="expected the signal's variance"):
        read([tmp_path / "totals.nc"])


def _table(ds, path):
    """Write drifters as ERDDAP does: names, units, a row a fix; a drogue that is not lost has the calendar's first date."""
    count = ds["rowsize"].values
    lost = np.repeat(ds["drogue_lost_date"].values, count).astype("datetime64[s]").astype(str)
    rows = zip(
        np.repeat(ds["ID"].values, count),
        np.repeat(count, count),
        ds["time"].values.astype("datetime64[s]").astype(str),
        ds["latitude"].values,
        ds["longitude"].values,
        ["1970-01-01T00:00:00Z" if each > "2019-01-20" else f"{each}Z" for each in lost],
        strict=True,
    )
    names = "ID,rowsize,time,latitude,longitude,drogue_lost_date"
    lines = [names, ",,UTC,degrees_north,degrees_east,UTC"]
    lines += [f"{a},{n},{b}Z,{c},{d},{e}" for a, n, b, c, d, e in rows]
    path.write_text("\n".join(lines) + "\n")


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


def test_a_table_whose_rows_are_cut_is_refused(tmp_path):
    path = tmp_path / "drifters.csv"
    _table(made.drifters(), path)
    path.write_text(path.read_text()[:-30])
    with pytest.raises(LogError, match="expected a table: names, perhaps units, rows as long"):
        read([path])
