"""A small sound file of each format of logs, by the format's name."""

from collections.abc import Callable, Mapping
from pathlib import Path

from tests.logs.adcp import ad2cp_samples, raw_adcp_samples
from tests.logs.log_samples import json_mcap, tlog
from tests.logs.mavlink.dataflash_samples import dataflash
from tests.logs.netcdf import glider_samples
from tests.logs.slocum import slocum_samples
from tests.logs.surface_samples import write_radials

PINGS = b"time,longitude,latitude,depth,u,v,error\n" + b"2018-11-16,152.1,-39.9,9,.1,.1,.05\n" * 9


def _radials(folder: Path) -> bytes:
    write_radials(folder / "made.ruv", (0.1, 0.0))
    return (folder / "made.ruv").read_bytes()


#: Makes the bytes of a file; what it needs is written to a folder.
SOUND: Mapping[str, Callable[[Path], bytes]] = {
    "mcap": lambda _: json_mcap(range(1000, 1000 + 60 * 10**7, 10**7)),
    "netcdf": lambda folder: glider_samples.spray(folder / "made.nc").read_bytes(),
    "seaexplorer": lambda folder: glider_samples.seaexplorer(folder)[0].read_bytes(),
    "slocum": lambda _: slocum_samples.file_bytes(
        slocum_samples.FLIGHT, slocum_samples.cycles_of(0)[0]
    ),
    "ad2cp": lambda _: ad2cp_samples.ad2cp(ad2cp_samples.Survey(), 6),
    "radials": _radials,
    "dataflash": lambda _: b"".join(dataflash(12)),
    "table": lambda _: PINGS,
    "tlog": lambda _: b"".join(tlog(40)),
    "pd0": lambda _: raw_adcp_samples.pd0(raw_adcp_samples.Survey(n=4, cells=6)),
}
