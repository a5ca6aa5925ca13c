"""Servers that hang, lie, break off, lead elsewhere or change their data: the sound forecast, or an error in words and no half file."""

import re
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from urllib.error import HTTPError
from urllib.request import urlopen

import numpy as np
import pytest

from replay_kit.core.errors import ConfigError, ForecastError
from replay_kit.core.paths import Address, path_of
from replay_kit.forecast.remote.answers import check_leads
from replay_kit.forecast.remote.client import Client, Limits
from replay_kit.forecast.remote.kept import record_of
from tests.forecast.remote.conftest import left_over, refused, sea
from tests.forecast.remote.servers import Files, griddap, opendap, serving, zarr_objects
from tests.forecast.remote.test_forms import needs

pytestmark = pytest.mark.filterwarnings("ignore:Consolidated metadata is currently not part")
FAULTS = ("close", "cut", "500", "503", "429", "403", "html", "short", "more", "absent")


@pytest.fixture(scope="module")
def objects():
    return zarr_objects(
        sea(), zarr_format=2, encoding={n: {"chunks": (1, 3, 2, 10, 20)} for n in ("uo", "vo")}
    )


@pytest.fixture(scope="module")
def grids():
    """Answers of griddap: a forecast, and the same data set later, with other values."""
    needs("xpublish_erddap")
    with griddap(sea()) as first, griddap(2 * sea()) as later:
        yield _from(first, 2), _from(later, 2)


@pytest.fixture
def served(request, objects):
    """Of a kind of server: its answers, the path of the forecast, and what an answer with values is asked by."""
    if request.param == "griddap":
        return (
            request.getfixturevalue("grids")[0],
            "/griddap/forecast",
            re.compile(r"\.dods\?[uv]o"),
        )
    return objects, "", re.compile(r"[uv]o/\d")


NO_ANSWER = r"no whole answer in \d attempts: "
#: Of each fault of all answers with values: the words of the error, for Zarr and for griddap; None where it is not tried.
FAULTY = {
    "close": (NO_ANSWER + "the connection was closed",) * 2,
    "cut": (None, NO_ANSWER + "the connection was closed"),
    "hang": ("no whole answer in 2 attempts: the server was silent for too long",) * 2,
    "500": (NO_ANSWER + "status 500; it says: out of order; check", None),
    "503": (
        None,
        NO_ANSWER
        + "status 503: it is busy or closed for maintenance; it says: out of order; check",
    ),
    "429": (
        None,
        NO_ANSWER + "status 429: it asks for fewer requests; it says: out of order; check",
    ),
    "403": ("answers with status 403: it refuses access",) * 2,
    "html": (
        "expected data, got a page of the web, as of a login",
        "the server answers: a page of the web, as of a login",
    ),
    "more": ("the server sends .* MB, where .* MB were expected at most; it was not read on", None),
    "short": ("what the server sends cannot be read", "the answer ends after"),
    "absent": (None, "the server answers: no data"),
    "flood": (None, "the server sends more, where .* MB were expected at most; it was not read on"),
    "redirect": (None, "which is in a private network; this is refused"),
}


@pytest.mark.parametrize(
    ("served", "fault", "words"),
    [
        (kind, fault, words)
        for fault, both in FAULTY.items()
        for kind, words in zip(("zarr", "griddap"), both, strict=True)
        if words
    ],
    indirect=["served"],
)
def test_a_faulty_server_is_an_error_in_words(asker, served, fault, words):
    answers, path, values = served
    asker.state.limits = Limits(silence=0.3 if fault == "hang" else 5.0, attempts=3, pause=0.001)
    files, inner = (
        Files(answers, lambda path, number: fault if values.search(path) else ""),
        Files(answers),
    )
    with serving(inner), serving(files):
        files.redirect = inner.url + path
        with pytest.raises(ForecastError, match=words):
            asker(files.url + path)
    assert inner.asked == []
    # what was too long was not received, but for what fits into the pipes
    assert files.sent < (2e7 if path else 2e8)
    assert not left_over(asker.folder)
    assert not list(asker.folder.glob("*.nc"))


@pytest.mark.parametrize(("fault", "tags"), [("cut", True), ("close", False)])
def test_what_fails_every_third_time_is_asked_again(asker, objects, fault, tags):
    asker.state.limits = Limits(attempts=12, pause=0.001)
    files = Files(objects, lambda path, number: fault if number % 3 == 0 else "", tags)
    with serving(files):
        np.testing.assert_array_equal(asker(files.url, None).uo, sea().uo)


def test_an_answer_that_broke_off_is_continued():
    data = bytes(np.random.default_rng(1).integers(0, 256, 100_000, dtype=np.uint8))
    files = Files({"a": data}, lambda path, number: "cut" if number < 5 else "")
    with serving(files):
        client = Client(Limits(pause=0.001))
        assert client.get(files.url + "/a", 1e6) == data
        # a half, a half of the rest ...
        assert files.sent == client.received == len(data)
        client.close()


def test_several_threads_receive_at_once_and_no_more_is_remembered_than_allowed(monkeypatch):
    monkeypatch.setattr(Client, "_REMEMBERED", 3000)
    client, before = Client(Limits()), sys.getswitchinterval()
    monkeypatch.setattr(
        client, "_receive", lambda url, body, most, probing: body.data.extend(bytes(10)) or True
    )
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(8) as pool:
            found = list(pool.map(lambda key: client.get(f"http://h/{key}", 1e3), range(600)))
    finally:
        sys.setswitchinterval(before)
        client.close()
    assert found == [bytes(10)] * 600
    assert len(client._held) == 300


def test_a_slow_drip_is_no_answer():
    with serving(Files({"a": b"x"})) as files:
        client = Client(Limits(silence=0.05, attempts=2, pause=0.001))
        response = type("Slow", (), {"read1": lambda self, n: time.sleep(0.03) or b"x"})()
        with pytest.raises(Exception, match="bytes in 0"):
            list(client._blocks(response))
        client.close()
    assert files.sent == 0


def test_data_that_change_between_two_requests_are_refused(asker, objects):
    other = zarr_objects(
        2 * sea(), zarr_format=2, encoding={n: {"chunks": (1, 3, 2, 10, 20)} for n in ("uo", "vo")}
    )
    files = Files({})

    def changing(key):
        held = objects if len([p for p in files.asked if p.startswith("vo/0")]) < 3 else other
        return held.get(key)

    files.objects = changing
    with serving(files):
        with pytest.raises(ForecastError, match="the data changed while they were received"):
            asker(files.url)
        assert not list(asker.folder.glob("*"))
        # a server that does not say what state its data are in: a field is received twice
        files.tags = False
        files.asked.clear()
        with pytest.raises(ForecastError, match="the data changed"):
            asker(files.url, None)


def test_redirections_lead_to_no_file_and_into_no_private_network(asker, objects):
    inner = Files(objects)
    with serving(inner), serving(Files(objects, lambda path, number: "redirect")) as files:
        for target, words in (
            (inner.url + "/x", "which is in a private network; this is refused"),
            ("http://169.254.169.254/latest", "which is in a private network"),
            ("http://localhost:1/x", "which is in a private network"),
            ("file:///etc/passwd", "which is no address of the web"),
            ("gopher://example.org/", "which is no address of the web"),
            (files.url + "/again", "redirects more than 5 times"),
        ):
            files.redirect = target
            assert words in refused(asker, files.url), target
        assert inner.asked == []
    with pytest.raises(ForecastError, match="which is not encrypted"):
        check_leads("https://example.org/a", "http://example.org/a")


def test_a_login_goes_to_its_own_server_and_is_shown_nowhere(asker, objects):
    with serving(Files(objects)) as files:
        host = files.url.partition("//")[2]
        url = f"http://pilot:s3cret@{host}?token=k3y"
        asker(url)
        assert {headers["Authorization"] for headers in files.headers} == {"Basic cGlsb3Q6czNjcmV0"}
        assert all(path.endswith("?token=k3y") for path in files.asked)
        for path in asker.folder.iterdir():
            held = path.read_bytes()
            assert b"s3cret" not in held
            assert b"k3y" not in held
        files.fault = lambda path, number: "403"
        files.objects = {}
        with pytest.raises(ForecastError) as raised:
            asker(url, "1,2,3,4")
        for text in (str(raised.value), repr(path_of(url)), str(path_of(url)), path_of(url).name):
            assert "s3cret" not in text
            assert "k3y" not in text


def test_a_page_and_nothing_at_all(asker):
    page = b"<!DOCTYPE html><html><title>Login</title></html>"
    with serving(Files(lambda path: page)) as files:
        assert "got a page of the web" in refused(asker, files.url + "/x")
    with serving(Files({})) as files:
        assert "expected a Zarr store with consolidated metadata" in refused(asker, files.url)
    assert "the connection is refused" in refused(asker, "http://127.0.0.1:1/x")


def test_a_store_that_cannot_be_listed_is_named(asker):
    ds = {
        key: value
        for key, value in zarr_objects(sea(), zarr_format=2).items()
        if key != ".zmetadata"
    }
    with serving(Files(ds)) as files:
        assert "without consolidated metadata" in refused(asker, files.url)


@pytest.mark.parametrize("served", ["zarr", "griddap"], indirect=True)
def test_another_ocean_and_another_year_are_said_before_values_are_received(asker, served):
    answers, path, values = served
    with serving(Files(answers)) as files:
        address = files.url + path
        assert "the forecast covers 152.000..155.900 E" in refused(asker, address, "-30,40,-29,41")
        words = refused(asker, address, logs={"start": "2024-01-01", "end": "2024-01-02"})
        assert "the forecast is of 2018-11-15 00:00:00Z to 2018-11-18" in words
        assert not [each for each in files.asked if values.search(each)]


def test_more_than_allowed_is_not_received(asker, objects):
    with serving(Files(objects)) as files:
        words = refused(asker, files.url, None, max_download=0.02)
        assert "more than --max-download 0.02 MB; choose less" in words
        client = Client(Limits(bytes=1000))
        with pytest.raises(
            ForecastError, match=r"more than --max-download 0\.001 MB were received"
        ):
            client.get(files.url + "/uo/0.0.0.0.0", 1e9)
        client.close()


def test_chunks_that_make_a_box_cost_ten_times_its_bytes_must_be_asked_for(asker, monkeypatch):
    monkeypatch.setattr("replay_kit.forecast.remote.fetch._LARGE", 1e4)
    with serving(Files(zarr_objects(sea(), zarr_format=2))) as files:
        words = refused(
            asker,
            files.url,
            "153,-39.2,153.2,-39",
            logs={"start": "2018-11-16", "end": "2018-11-16"},
        )
        assert "MB of values cost 0.4" in words
        assert "ask for it: --max-download 1" in words
        asker(files.url, "153,-39.2,153.2,-39", max_download=1.0)


def test_a_chunk_larger_than_memory_is_refused(asker):
    asker.state.limits = Limits(memory=1e5)
    with serving(Files(zarr_objects(sea(), zarr_format=2))) as files:
        assert "a chunk of uo takes 0.2304 MB in memory" in refused(asker, files.url)


def _from(url, depth=1):
    """Return what another server answers, the last parts of its address before what is asked for; each answer is asked for once."""

    @cache
    def objects(path):
        try:
            with urlopen(f"{url.rsplit('/', depth)[0]}/{path}") as answer:
                return answer.read()
        except HTTPError:
            return None

    return objects


def test_a_griddap_that_closes_every_third_connection_gives_the_sound_forecast(asker, grids):
    asker.state.limits = Limits(attempts=5, pause=0.001)
    files = Files(grids[0], lambda path, number: "close" if number % 3 == 0 else "")
    with serving(files):
        np.testing.assert_array_equal(asker(files.url + "/griddap/forecast", None).uo, sea().uo)
        assert record_of(asker.state.fetched.files[0])["form"] == "ERDDAP griddap"


def test_a_griddap_that_changes_between_two_requests_is_refused(asker, grids):
    files = Files({})
    files.objects = lambda path: grids[any(".dods?vo" in each for each in files.asked)](path)
    with serving(files), pytest.raises(ForecastError, match="the data changed while they were"):
        asker(files.url + "/griddap/forecast")
    assert not list(asker.folder.glob("*"))


def _random_runs(asker, objects, url_of, runs):
    """Fetch with faults at random; return how many gave the sound forecast."""
    asker.state.limits = Limits(silence=2.0, attempts=4, pause=0.0005)
    sound, good = None, 0
    for run in range(runs):
        rng, lock = np.random.default_rng(run), threading.Lock()
        rate = 0.0 if run == 0 else rng.choice([0.002, 0.01, 0.03])

        def fault(path, number, rng=rng, lock=lock, rate=rate):
            with lock:
                return str(rng.choice(FAULTS)) if rng.random() < rate else ""

        for path in asker.folder.glob("*"):
            path.unlink()
        files = Files(objects, fault)
        with serving(files):
            try:
                found = asker(url_of(files))
            except ForecastError as error:
                found, words = None, str(error)
        if found is None:
            assert words.startswith("http://127.0.0.1")
            assert not list(asker.folder.glob("*")), run
            continue
        assert not left_over(asker.folder), run
        sound = found if sound is None else sound
        assert found.drop_attrs().identical(sound.drop_attrs()), run
        good += 1
    return good


@pytest.mark.full
def test_two_hundred_runs_with_random_failures(asker, objects):
    needs("pydap")
    good = _random_runs(asker, objects, lambda files: files.url, 100)
    assert 20 < good < 100
    with opendap(sea().drop_vars("time")) as url:
        good = _random_runs(asker, _from(url), lambda files: files.url + "/forecast", 100)
    assert 20 < good < 100


def test_an_address_is_kept_as_it_was_given():
    url = "https://example.org//a//b.zarr"
    assert isinstance(path_of(url), Address)
    assert path_of(url).url == str(path_of(url)) == url
    assert str(path_of("cmems:cmems_mod_glo_phy")) == "cmems:cmems_mod_glo_phy"
    assert str(path_of("file:///tmp/e.nc")) == "/tmp/e.nc"
    with pytest.raises(ConfigError, match="give the https address of the same data"):
        path_of("s3://bucket/e.zarr")
