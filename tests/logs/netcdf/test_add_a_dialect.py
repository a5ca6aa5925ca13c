"""A dialect that is added as the page says: a value in a list, and the reader serves its files."""

from dataclasses import replace

import numpy as np
import pytest

from replay_kit.logs.netcdf import reader
from replay_kit.logs.netcdf.dialects import Dialect
from replay_kit.logs.netcdf.surface import TOTALS
from tests.logs import surface_samples
from tests.logs.netcdf import glider_samples as made
from tests.logs.said import read

MINE = Dialect(
    "mine",
    "A glider of mine",
    "when east north",
    {
        "time": "when",
        "longitude": "east",
        "latitude": "north",
        "depth": "below",
        "dac_east": "drift_east",
        "dac_north": "drift_north",
    },
    log_of="mission",
    pings=lambda file, notes: iter(
        [(round(made.START) * 10**9, "/adcp", "test.Ping", {"rows": file.array("when").size})]
    ),
)


def _write(path, dive):
    track = made.samples()
    rows = track["dive"] == dive
    units = {
        "when": made.EPOCH,
        "east": {"units": "degrees_east"},
        "north": {"units": "degrees_north"},
        "below": {"units": "m"},
    }
    held = zip(units.items(), ("time", "longitude", "latitude", "depth"), strict=True)
    variables: made.Variables = {
        name: (("row",), track[key][rows], attributes) for (name, attributes), key in held
    }
    for name, value in zip(("drift_east", "drift_north"), made.mean(dive), strict=True):
        variables[name] = (("row",), np.full(rows.sum(), value), {"units": "m s-1"})
    return made.write(path, variables, {"deployment_name": "one"})


def test_files_of_an_added_dialect_are_one_log_with_its_currents_and_pings(tmp_path, monkeypatch):
    files = [_write(tmp_path / f"{dive}.nc", dive) for dive in (0, 1)]
    assert "/dac" not in read(files[0]).counts()
    monkeypatch.setattr(reader, "DIALECTS", (MINE, *reader.DIALECTS))
    said = read(files)
    assert said.report.format == "mine"
    means = [(mean["dac_eastward"], mean["dac_northward"]) for mean in said.of("/dac")]
    assert means == [pytest.approx(made.mean(dive)) for dive in (0, 1)]
    assert said.of("/adcp") == [{"rows": 59}, {"rows": 59}]


def test_totals_of_other_names_are_those_of_the_usual_ones(tmp_path, monkeypatch):
    names = {"u": "ucomp", "v": "vcomp", "u_err": "ustd", "v_err": "vstd", "time": "HOUR"}
    other = replace(
        TOTALS,
        name="mine",
        signature=" ".join(names.values()).lower(),
        names={key: names.get(name, name).lower() for key, name in TOTALS.names.items()},
    )
    monkeypatch.setattr(reader, "DIALECTS", (other, *reader.DIALECTS))
    usual = surface_samples.totals((0.1, 0.2))
    usual.to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
    usual.rename(names).to_netcdf(tmp_path / "b.nc", engine="h5netcdf")
    one, same = (read(tmp_path / name) for name in ("a.nc", "b.nc"))
    assert (one.report.format, same.report.format) == ("radar-totals", "mine")
    assert one.messages == same.messages
