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
    """The members and the names of the forecast's files that the result of a short replay records."""
    short = f"-o {out} --levels 5,150 --modes 2 --end 2018-11-16T03:00:00Z {more}"
    succeed(f"replay {SAMPLES}/glider.mcap --ensemble {' '.join(map(str, files))} {short}")
    records = metadata_of(out)
    inputs = {key: value.split()[0] for key, value in records["replay_kit.inputs"].items()}
    assert inputs.pop("log0") == "glider.mcap"
    return records["replay_kit.members"], inputs


def test_a_result_names_its_members_and_is_made_again(members, tmp_path):
    out = tmp_path / "out.mcap"
    names, inputs = records_of(out, sorted(members.glob("*.nc")))
    assert names == {str(k): f"mem00{k}.nc" for k in range(3)}
    assert inputs == {f"ensemble{k}": f"mem00{k}.nc" for k in range(3)}
    succeed(f"verify {out} --inputs {members} --inputs {SAMPLES}")


@pytest.mark.parametrize("products", [2, 1])
@pytest.mark.full
def test_files_of_one_product_belong_together_when_a_result_is_made_again(
    members, tmp_path, products
):
    """Two files of each of two models, or one file of each in one folder, which are then a model each."""
    folders = [tmp_path / name for name in ("glorys", "hycom")[:products]]
    expected = {
        f"ensemble{k}_{day}": folder / f"{folder.name}_{day}.nc"
        for k, folder in enumerate(folders)
        for day in range(2)
    }
    for k, path in enumerate(expected.values()):
        path.parent.mkdir(exist_ok=True)
        with xr.open_dataset(members / f"mem00{k % 3}.nc") as ds:
            day = np.datetime64("2018-11-16", "ns") + np.timedelta64(k % 2, "D")
            held = ds.load().drop_vars("time", errors="ignore")
            save(held.expand_dims(time=[day]), path)
    out, apart = tmp_path / "out.mcap", tmp_path / "apart.mcap"
    names, inputs = records_of(out, folders, "--members models")
    assert inputs == {key: path.name for key, path in expected.items()}
    assert len(names) == 2
    searched = " ".join(f"--inputs {folder}" for folder in (*folders, SAMPLES))
    succeed(f"verify {out} {searched}")
    # each file for itself is another product of it
    records_of(apart, expected.values(), "--members models")
    assert apart.read_bytes() != out.read_bytes()


def test_one_field_is_no_ensemble_and_what_could_make_one_is_said(members, tmp_path):
    line = f"replay {SAMPLES}/glider.mcap --ensemble {members}/mem000.nc -o {tmp_path}/out.mcap"
    done = invoke(line)
    assert done.exit_code == 3
    assert "no member dimension" in done.output
    assert "give several files" in done.output
