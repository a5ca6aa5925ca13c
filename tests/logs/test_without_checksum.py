"""Formats without checksums say so, in what `info` and `convert` print and in their JSON."""

from io import StringIO

import numpy as np
import pytest

from replay_kit.config.run import LogConfig, RunConfig
from replay_kit.logs import open_log
from replay_kit.show.text import SafeConsole
from replay_kit.workflows.convert import convert, convert_json, print_converted
from replay_kit.workflows.info.inspect import inspect_logs
from replay_kit.workflows.info.listing import info_json, print_info
from tests.logs.log_samples import json_mcap, tlog
from tests.logs.mavlink.dataflash_samples import dataflash
from tests.logs.netcdf import glider_samples as gliders

DATAFLASH, VALUES, STAMPS = (
    "records of a DataFlash log",
    "values of NetCDF, text or Slocum files",
    "stamps of frames",
)


def _rows(path):
    time = np.arange(3.0)
    return gliders.write(
        path,
        {
            "time": (("time",), time, {"units": "seconds since 2020-01-01"}),
            "speed": (("time",), time, {}),
        },
    )


def _made(folder, kind):
    if kind == "seaexplorer":
        return gliders.seaexplorer(folder)[0]
    path = folder / "log"
    if kind in ("spray", "rows"):
        return gliders.spray(path) if kind == "spray" else _rows(path)
    if kind == "dataflash":
        path.write_bytes(b"".join(dataflash(3)))
    elif kind == "tlog":
        path.write_bytes(b"".join(tlog(4)))
    else:
        path.write_bytes(json_mcap(range(4)))
    return path


@pytest.mark.parametrize(
    ("kind", "what"),
    [
        ("dataflash", DATAFLASH),
        ("spray", VALUES),
        ("rows", VALUES),
        ("seaexplorer", VALUES),
        ("tlog", STAMPS),
        ("mcap", None),
    ],
)
def test_info_and_convert_say_what_no_checksum_covers(tmp_path, kind, what):
    path = _made(tmp_path, kind)
    log = open_log(path)
    assert log.report().unchecked == {}
    list(log.messages())
    read = log.report()
    assert dict(read.unchecked) == ({} if what is None else {what: sum(read.read.values())})
    line = f"Without a checksum, so that damage cannot be detected: {path}: {what} ({sum(read.read.values())})"
    found, summary = (
        inspect_logs([path], RunConfig())[0],
        convert([path], tmp_path / "out.mcap", False, LogConfig()),
    )
    for show, value in ((print_info, found), (print_converted, summary)):
        text = StringIO()
        show(value, SafeConsole(file=text, width=400))
        assert (line in text.getvalue()) is (what is not None)
    assert info_json(found)["unchecked"] == dict(read.unchecked)
    told = [
        {"file": str(path), "what": kind, "count": count} for kind, count in read.unchecked.items()
    ]
    assert convert_json(summary)["unchecked"] == told
