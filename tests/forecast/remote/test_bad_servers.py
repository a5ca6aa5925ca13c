"""Servers that hang, break off, lie about lengths or lead elsewhere: the sound forecast, or an error in words and no half file."""

import re
from functools import cache
from urllib.error import HTTPError
from urllib.request import urlopen

import numpy as np
import pytest

from replay_kit.config.run import load_config
from replay_kit.core.errors import ConfigError, ForecastError
from replay_kit.core.files.paths import Address, path_of
from replay_kit.core.words.progress import shown_by
from replay_kit.forecast.remote import servers
from replay_kit.forecast.remote.apart import call_apart
from replay_kit.workflows import fetch
from replay_kit.workflows.replay.inputs.job import ReplayJob
from tests.forecast import remote as calls
from tests.forecast.remote.conftest import left_over, refused, sea
from tests.forecast.remote.servers import Files, griddap, serving, zarr_objects
from tests.forecast.remote.test_forms import needs

pytestmark = pytest.mark.filterwarnings("ignore:Consolidated metadata is currently not part")


@pytest.fixture(scope="module")
def objects():
    return zarr_objects(
        sea(), zarr_format=2, encoding={n: {"chunks": (1, 3, 2, 10, 20)} for n in ("uo", "vo")}
    )


@pytest.fixture(scope="module")
def grids():
    """Answers of griddap, each of which it is asked for once."""
    needs("xpublish_erddap")

    @cache
    def answer(path):
        try:
            with urlopen(f"{url.rsplit('/', 2)[0]}/{path}") as given:
                return given.read()
        except HTTPError:
            return None

    with griddap(sea()) as url:
        yield answer


@pytest.fixture
def served(request, objects):
    """Of a kind of server: its answers, the path of the forecast, and what an answer with values is asked by."""
    if request.param == "griddap":
        grids = request.getfixturevalue("grids")
        return grids, "/griddap/forecast", re.compile(r"\.dods\?[uv]o")
    return objects, "", re.compile(r"[uv]o/\d")


@pytest.mark.parametrize(
    ("served", "fault"),
    [
        *(("zarr", fault) for fault in ("close", "cut", "500", "403", "html", "short", "redirect")),
        *(("griddap", fault) for fault in ("cut", "500", "html", "short")),
    ],
    indirect=["served"],
)
def test_a_faulty_server_is_an_error_in_words(asker, served, fault, monkeypatch):
    answers, path, values = served
    # xarray waits half a minute in all
    monkeypatch.setattr("xarray.backends.common.time.sleep", lambda seconds: None)
    files = Files(answers, lambda path, number: fault if values.search(path) else "")
    with serving(files):
        # round and round
        files.redirect = files.url + "/uo/0"
        words = refused(asker, files.url + path)
    assert words.startswith(f"{files.url}{path}: incomplete answer of the server: ")
    assert "; check the connection" in words
    assert not left_over(asker.folder)


def test_what_fails_every_third_time_is_asked_again(asker, objects, monkeypatch):
    monkeypatch.setattr(servers, "_ATTEMPTS", 12)
    asked = []

    def fault(path, number):
        asked.append(path)
        return "close" if path.startswith(("uo/0", "vo/0")) and len(asked) % 3 == 0 else ""

    with serving(Files(objects, fault)) as files:
        np.testing.assert_array_equal(asker(files.url, None).uo, sea().uo)


def test_a_login_goes_to_its_own_server_and_is_shown_nowhere(asker, objects):
    with serving(Files(objects)) as files:
        url = f"http://pilot:s3cret@{files.url.partition('//')[2]}"
        asker(url)
        assert {headers["Authorization"] for headers in files.headers} == {"Basic cGlsb3Q6czNjcmV0"}
        for path in asker.folder.iterdir():
            assert b"s3cret" not in path.read_bytes()
        files.fault = lambda path, number: "403"
        with pytest.raises(ForecastError) as raised:
            asker(url, "1,2,3,4")
        for text in (str(raised.value), repr(path_of(url)), str(path_of(url)), path_of(url).name):
            assert "s3cret" not in text


def test_what_is_no_store_is_named(asker, objects):
    page = b"<!DOCTYPE html><html><title>Login</title></html>"
    unlisted = {key: value for key, value in objects.items() if key != ".zmetadata"}
    for held, words in (
        (lambda path: page, "got a web page"),
        ({}, "expected a Zarr store with consolidated metadata"),
        (unlisted, "without consolidated metadata"),
    ):
        with serving(Files(held)) as files:
            assert words in refused(asker, files.url)
    words = refused(asker, "http://127.0.0.1:1/x")
    assert "the server cannot be reached: Connection refused" in words


def test_more_than_is_allowed_is_refused_by_the_size_of_the_chunks_that_are_touched(
    asker, monkeypatch
):
    box = "153,-39.2,153.2,-39"
    with serving(Files(zarr_objects(sea(), zarr_format=2))) as files:
        words = refused(asker, files.url, box, max_download=0.4)
        assert ": 0.4614 MB to download, more than --max-download 0.4 MB; choose less" in words
        assert not [path for path in files.asked if re.match(r"[uv]o/\d", path)]
        asker(files.url, box, max_download=0.5)
        monkeypatch.setattr(servers, "_MOST", 1e5)
        with pytest.raises(ForecastError, match=r"a chunk of uo takes 0\.2304 MB in memory"):
            asker(files.url)


def test_a_call_apart_gives_its_value_its_progress_and_its_error():
    told = []
    with shown_by(lambda *words: told.append(words)):
        assert call_apart(calls.announces, "abc", what="x") == "ABC"
    assert told[0] == (0, 3, "abc")
    assert len(told) == 3
    with pytest.raises(ForecastError, match="no such sea"):
        call_apart(calls.refuses, what="x")


@pytest.mark.parametrize(
    ("call", "silence", "words"),
    [
        (calls.hangs, 1.0, "x: the server was silent for 1 s"),
        (calls.dies, 20.0, "x: reading from the server ended with status 3"),
        (calls.takes_all, 20.0, "x: the server sends more than the memory limit"),
    ],
)
def test_a_call_that_hangs_dies_or_takes_all_memory_is_ended(call, silence, words, monkeypatch):
    monkeypatch.setattr("replay_kit.forecast.remote.apart._SILENCE", silence)
    with pytest.raises(ForecastError, match=words):
        call_apart(call, what="x")


@pytest.mark.parametrize("fault", ["", pytest.param("flood", marks=pytest.mark.full)])
def test_a_forecast_is_fetched_in_a_process_of_its_own(tmp_path, objects, fault, monkeypatch):
    monkeypatch.setattr("replay_kit.forecast.remote.apart._SILENCE", 30.0)
    files = Files(objects, lambda path, number: fault if path.startswith("uo/0") else "")
    with serving(files):
        forecast = {"cache": str(tmp_path), "region": (153.0, -39.5, 154.5, -38.5)}
        job = ReplayJob((), (path_of(files.url),))
        request = fetch.request_of(job, load_config(None, {"forecast": forecast}))
        if fault:
            with pytest.raises(ForecastError, match=files.url):
                fetch.fetch(request)
            assert not list(tmp_path.glob("*.nc"))
        else:
            assert fetch.fetch(request).files[0].parent == tmp_path


def test_an_address_is_kept_as_it_was_given():
    url = "https://example.org//a//b.zarr"
    assert isinstance(path_of(url), Address)
    assert path_of(url).url == str(path_of(url)) == url
    assert str(path_of("cmems:cmems_mod_glo_phy")) == "cmems:cmems_mod_glo_phy"
    assert str(path_of("file:///tmp/e.nc")) == "/tmp/e.nc"
    with pytest.raises(ConfigError, match="give the https address of the same data"):
        path_of("s3://bucket/e.zarr")
