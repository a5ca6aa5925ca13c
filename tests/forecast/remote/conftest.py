"""A forecast of a small sea, and requests with it."""

import logging
from types import SimpleNamespace

import fsspec
import numpy as np
import pytest
import xarray as xr

from replay_kit.config.run import load_config
from replay_kit.core.errors import ForecastError
from replay_kit.core.files.paths import path_of
from replay_kit.core.region import Region
from replay_kit.forecast.remote import apart, servers
from replay_kit.workflows import fetch
from replay_kit.workflows.replay.inputs.job import ReplayJob
from tests import synthetic
from tests.forecast.forms import in_turn

pytest.importorskip("aiohttp", reason="the extra 'remote' is not installed")

#: A part of it.
BOX = "153,-39.5,154.5,-38.5"


def sea(times: int = 4, shape: tuple[int, int] = (30, 40), step: float = 0.1) -> xr.Dataset:
    """An ensemble at several times, as float32, without encodings."""
    one = synthetic.dataset(seed=2, n_members=3, shape=shape, step=step)
    days = np.datetime64("2018-11-15T00", "ns") + np.arange(times) * np.timedelta64(24, "h")
    each = [one * (1 + 0.1 * k) for k in range(times)]
    return in_turn(each, days, standard_name="time").astype("f4")


@pytest.fixture
def here(monkeypatch):
    """Servers are asked in this process."""

    def call(function, *arguments, what):
        servers.served.cache_clear()
        fsspec.filesystem("http").invalidate_cache()
        with apart.asking():
            return function(*arguments)

    monkeypatch.setattr(fetch, "call_apart", call)
    monkeypatch.setattr(servers, "_PAUSE", 0.002)


@pytest.fixture
def asker(tmp_path, here):
    """Fetches a part of a forecast: ``asker(url, region=..., ...)`` is the file, opened and loaded."""
    logging.disable(logging.WARNING)
    state = SimpleNamespace(fetched=None)

    def ask(url: str, region: Region | str | None = BOX, logs: dict | None = None, **settings):
        if isinstance(region, str):
            region = tuple(map(float, region.split(",")))
        forecast = {"cache": str(tmp_path / "cache"), "region": region, **settings}
        config = load_config(None, {"forecast": forecast, "logs": logs or {}})
        state.fetched = fetch.fetch(fetch.request_of(ReplayJob((), (path_of(url),)), config))
        with xr.open_dataset(state.fetched.files[0], decode_timedelta=False) as ds:
            return ds.load()

    ask.state, ask.folder = state, tmp_path / "cache"
    yield ask
    logging.disable(logging.NOTSET)


def left_over(folder) -> list[str]:
    """Names of files that are no whole result."""
    return [path.name for path in folder.glob("*") if path.suffix not in (".nc", ".json")]


def refused(ask, *arguments, **options) -> str:
    """The words of a refusal; nothing is kept."""
    with pytest.raises(ForecastError) as raised:
        ask(*arguments, **options)
    assert not list(ask.folder.glob("*")) if ask.folder.exists() else True
    return str(raised.value)
