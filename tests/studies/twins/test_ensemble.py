import numpy as np
import pytest

from replay_kit.config.run import ForecastConfig
from replay_kit.core.errors import ConfigError
from replay_kit.forecast import read_ensemble, read_truth
from replay_kit.studies.twins import ensemble as synthetic
from tests.command import succeed
from tests.places import SAMPLES


def _velocity(seed: int) -> np.ndarray:
    members, _ = synthetic.synthesize(seed)
    return np.stack([members.uo.values, members.vo.values], axis=1)


def test_the_sample_files_are_what_the_command_writes(tmp_path):
    files = [tmp_path / name for name in ("ensemble.nc", "truth.nc")]
    succeed(f"synthesize --ensemble {files[0]} --truth {files[1]}")
    for path in files:
        assert path.read_bytes() == (SAMPLES / path.name).read_bytes(), path.name


@pytest.mark.parametrize("seed", [0, 3])
def test_speed_and_spread_are_those_of_an_eddying_ocean(seed):
    velocity = _velocity(seed)
    rms = np.sqrt((velocity**2).sum(axis=1).mean())
    spread = np.sqrt(velocity.var(axis=0, ddof=1).sum(axis=0).mean())
    assert 0.24 < rms < 0.30
    assert 0.6 < spread / rms < 0.7
    by_level = np.sqrt((velocity**2).sum(axis=1).mean(axis=(0, 2, 3)))
    assert (np.diff(by_level) < 0.0).all()
    assert np.sqrt((velocity**2).sum(axis=1)).max() < 1.5


def test_divergence_is_zero_at_every_depth():
    rng = np.random.default_rng(0)
    eddies, jet = synthetic.common_draw(rng)
    ranges = (-8e4, 8e4), (-5e4, 5e4), (0.0, 750.0)
    east, north, depth = (rng.uniform(*ends, 300) for ends in ranges)
    h = 10.0

    def at(d_east: float, d_north: float) -> tuple[np.ndarray, np.ndarray]:
        return synthetic.velocity((eddies,), jet, east + d_east, north + d_north, depth)

    across = (at(h, 0.0)[0] - at(-h, 0.0)[0]) / (2 * h)
    along = (at(0.0, h)[1] - at(0.0, -h)[1]) / (2 * h)
    # derivatives are of the order of 1e-5 / s; central differences over 20 m err by 1e-12 / s
    assert np.abs(across).max() > 1e-6
    np.testing.assert_allclose(across + along, 0.0, atol=1e-11)


def test_the_truth_does_not_depend_on_the_number_of_members():
    np.testing.assert_array_equal(
        synthetic.synthesize(5, 2)[1].uo, synthetic.synthesize(5, 9)[1].uo
    )


def test_files_are_read_as_a_forecast(tmp_path):
    files = tmp_path / "e.nc", tmp_path / "t.nc"
    members, truth = synthetic.write_ensemble(*files, n_members=3, seed=4)
    read = read_ensemble(files[0], ForecastConfig())
    assert read.velocity.shape == (3, 2, 6, 13, 21)
    assert read.time_ns == 1_542_326_400_000_000_000
    rms = float(np.sqrt((members.uo**2 + members.vo**2).mean() / 2))
    assert np.sqrt(np.nanmean(read.velocity**2)) == pytest.approx(rms, rel=1e-3)
    again = read_truth(str(files[1]), ForecastConfig())
    assert np.abs(again.velocity[0, 0, 0] - truth.uo.values[0]).max() < 0.02


def test_existing_files_are_kept(tmp_path):
    (tmp_path / "t.nc").write_text("mine")
    with pytest.raises(ConfigError, match="overwrite"):
        synthetic.write_ensemble(tmp_path / "e.nc", tmp_path / "t.nc")
    assert not (tmp_path / "e.nc").exists()
    synthetic.write_ensemble(tmp_path / "e.nc", tmp_path / "t.nc", n_members=2, overwrite=True)
    assert (tmp_path / "t.nc").read_bytes()[:3] == b"CDF"


@pytest.mark.parametrize(("members", "seed"), [(1, 0), (5, -1)])
def test_bad_arguments_are_refused(members, seed):
    with pytest.raises(ConfigError, match="expected at least 2"):
        synthetic.synthesize(seed, members)
