"""A replay of an ensemble of several files: where each member comes from is kept, and the result can be made again."""

import pytest
import xarray as xr
from mcap.reader import make_reader

from tests.command import invoke
from tests.forecast.test_forms import save
from tests.places import SAMPLES


@pytest.fixture(scope="module")
def members(tmp_path_factory):
    folder = tmp_path_factory.mktemp("members")
    with xr.open_dataset(SAMPLES / "ensemble.nc") as ds:
        for k in range(3):
            save(ds.isel(member=k, drop=True).load(), folder / f"mem{k:03d}.nc")
    return folder


def test_a_result_names_its_members_and_is_made_again(members, tmp_path):
    out = tmp_path / "out.mcap"
    words = ["--levels", "5,150", "--modes", "2", "--end", "2018-11-16T03:00:00Z"]
    files = sorted(map(str, members.glob("*.nc")))
    done = invoke(["replay", str(SAMPLES / "glider.mcap"), "--ensemble", *files, "-o", str(out), *words])
    assert done.exit_code == 0, done.output
    with out.open("rb") as stream:
        records = {record.name: dict(record.metadata) for record in make_reader(stream).iter_metadata()}
    assert records["replay_kit.members"] == {"0": "mem000.nc", "1": "mem001.nc", "2": "mem002.nc"}
    inputs = records["replay_kit.inputs"]
    assert [inputs[f"ensemble{k}"].split()[0] for k in range(3)] == ["mem000.nc", "mem001.nc", "mem002.nc"]
    again = invoke(["verify", str(out), "--inputs", str(members), "--inputs", str(SAMPLES)])
    assert again.exit_code == 0, again.output


def test_one_field_is_no_ensemble_and_what_could_make_one_is_said(members, tmp_path):
    out = str(tmp_path / "out.mcap")
    done = invoke(["replay", str(SAMPLES / "glider.mcap"), "--ensemble", str(members / "mem000.nc"), "-o", out])
    assert done.exit_code == 3
    assert "no member dimension" in done.output
    assert "give several files, of other times, starts or members, with --ensemble" in done.output
