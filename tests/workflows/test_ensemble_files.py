"""A replay of an ensemble of several files: where each member comes from is kept, and the result can be made again."""

import numpy as np
import pytest
import xarray as xr

from tests.command import invoke, succeed
from tests.forecast.forms import save
from tests.places import SAMPLES
from tests.results.result_samples import metadata_of


@pytest.fixture(scope="module")
def members(tmp_path_factory):
    folder = tmp_path_factory.mktemp("members")
    with xr.open_dataset(SAMPLES / "ensemble.nc") as ds:
        for k in range(3):
            save(ds.isel(member=k, drop=True).load(), folder / f"mem{k:03d}.nc")
    return folder


def records_of(out, files, more=""):
    """The metadata of the result of a short replay on an ensemble of some files."""
    words = (
        f"{' '.join(map(str, files))} -o {out} --levels 5,150 --modes 2 --end 2018-11-16T03:00:00Z"
    )
    succeed(f"replay {SAMPLES}/glider.mcap --ensemble {words} {more}")
    return metadata_of(out)


def test_a_result_names_its_members_and_is_made_again(members, tmp_path):
    out = tmp_path / "out.mcap"
    records = records_of(out, sorted(members.glob("*.nc")))
    assert records["replay_kit.members"] == {"0": "mem000.nc", "1": "mem001.nc", "2": "mem002.nc"}
    inputs = records["replay_kit.inputs"]
    assert [inputs[f"ensemble{k}"].split()[0] for k in range(3)] == [
        "mem000.nc",
        "mem001.nc",
        "mem002.nc",
    ]
    succeed(f"verify {out} --inputs {members} --inputs {SAMPLES}")


@pytest.mark.parametrize("products", [2, 1])
@pytest.mark.full
def test_files_of_one_product_belong_together_when_a_result_is_made_again(
    members, tmp_path, products
):
    """Two files of each of two models, or one file of each in one folder, which are then a model each."""
    folders = [tmp_path / name for name in ("glorys", "hycom")[:products]]
    for k, folder in enumerate(folders):
        folder.mkdir()
        for day in range(2):
            with xr.open_dataset(members / f"mem00{(k + day) % 3}.nc") as ds:
                day_ns = np.datetime64("2018-11-16", "ns") + np.timedelta64(day, "D")
                save(
                    ds.load().drop_vars("time", errors="ignore").expand_dims(time=[day_ns]),
                    folder / f"{folder.name}_{day}.nc",
                )
    out = tmp_path / "out.mcap"
    records = records_of(out, folders, "--members models")
    inputs = {
        key: value.split()[0]
        for key, value in records["replay_kit.inputs"].items()
        if key != "log0"
    }
    expected = {
        f"ensemble{k}_{day}": f"{folder.name}_{day}.nc"
        for k, folder in enumerate(folders)
        for day in range(2)
    }
    assert inputs == expected
    assert len(records["replay_kit.members"]) == 2
    searched = " ".join(f"--inputs {folder}" for folder in (*folders, SAMPLES))
    succeed(f"verify {out} {searched}")
    # each file for itself is another product of it
    files = [folder / f"{folder.name}_{day}.nc" for folder in folders for day in range(2)]
    records_of(tmp_path / "apart.mcap", files, "--members models")
    assert (tmp_path / "apart.mcap").read_bytes() != out.read_bytes()


def test_one_field_is_no_ensemble_and_what_could_make_one_is_said(members, tmp_path):
    out = str(tmp_path / "out.mcap")
    done = invoke(f"replay {SAMPLES}/glider.mcap --ensemble {members}/mem000.nc -o {out}")
    assert done.exit_code == 3
    assert "no member dimension" in done.output
    assert "give several files, of other times, starts or members, with --ensemble" in done.output
