"""Made files of a Slocum: any sensors and cycles, and the mission of ``glider_samples`` as flight and science files."""

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path

import gsw
import lz4.block
import numpy as np

from tests.logs.netcdf import glider_samples as made

#: Sensor, bytes of a value, unit.
Sensors = Sequence[tuple[str, int, str]]
#: A cycle: by sensor a new value, or None for the same as before; what is not in it is not written.
Cycle = Mapping[str, float | None]
FORMS = {1: "b", 2: "h", 4: "f", 8: "d"}

FLIGHT: Sensors = (
    *(("m_present_time", 8, "timestamp"), ("m_depth", 4, "m"), ("m_lat", 8, "lat")),
    *(("m_lon", 8, "lon"), ("m_gps_lat", 8, "lat"), ("m_gps_lon", 8, "lon")),
    *(("m_gps_status", 1, "enum"), ("m_heading", 4, "rad"), ("m_pitch", 4, "rad")),
    *(("m_water_vx", 4, "m/s"), ("m_water_vy", 4, "m/s")),
    *(("m_final_water_vx", 4, "m/s"), ("m_final_water_vy", 4, "m/s")),
    *(("c_wpt_lat", 8, "lat"), ("c_wpt_lon", 8, "lon"), ("m_battery", 4, "volts")),
    *(("m_altitude", 4, "m"), ("x_counter", 2, "nodim")),
)
SCIENCE: Sensors = (
    ("sci_m_present_time", 8, "timestamp"),
    *(("sci_water_pressure", 4, "bar"), ("sci_water_temp", 4, "degc")),
    ("sci_water_cond", 4, "s/m"),
)


def sensor_list(sensors: Sensors) -> bytes:
    """Return the text of a list of sensors, with one that the files do not hold."""
    lines = [
        f"s: T {k + 1:4d} {k:4d} {size} {name} {unit}\n"
        for k, (name, size, unit) in enumerate(sensors)
    ]
    return ("s: F    0   -1 4 x_not_here nodim\n" + "".join(lines)).encode()


def file_bytes(
    sensors: Sensors,
    cycles: Sequence[Cycle],
    order: str = ">",
    crc: str = "",
    segment: str = "unit_1-2023-317-0-0",
    ending: str = "sbd",
) -> bytes:
    """Return a file; with ``crc`` its list of sensors is left to a cache."""
    listed = b"" if crc else sensor_list(sensors)
    tags = {
        "dbd_label": "DBD(dinkum_binary_data)file",
        "encoding_ver": 5,
        "num_ascii_tags": 14,
        "all_sensors": "F",
        "the8x3_filename": "00010000",
        "full_filename": segment,
        "filename_extension": ending,
        "mission_name": "TEST.MI",
        "fileopen_time": "Tue_Nov_14_22:13:20_2023",
        "total_num_sensors": len(sensors) + 1,
        "sensors_per_cycle": len(sensors),
        "state_bytes_per_cycle": (len(sensors) + 3) // 4,
        "sensor_list_crc": crc or "00000000",
        "sensor_list_factored": int(bool(crc)),
    }
    head = "".join(f"{key}:    {value}\n" for key, value in tags.items()).encode()
    known = b"sa" + struct.pack(f"{order}hfd", 0x1234, 123.456, 123456789.12345)
    body = b"".join(cycle_bytes(sensors, cycle, order) for cycle in cycles)
    return head + listed + known + body + b"X"


def cycle_bytes(sensors: Sensors, cycle: Cycle, order: str = ">") -> bytes:
    """Return one cycle."""
    states, values = bytearray((len(sensors) + 3) // 4), b""
    for k, (name, size, _) in enumerate(sensors):
        if name in cycle:
            value = cycle[name]
            states[k // 4] |= (1 if value is None else 2) << (6 - 2 * (k % 4))
            number = value if size > 2 or value is None else round(value)
            values += b"" if value is None else struct.pack(order + FORMS[size], number)
    return b"d" + bytes(states) + values


def compressed(data: bytes) -> bytes:
    """Return a file as the glider compresses it: LZ4 blocks after their lengths."""
    blocks = (data[at : at + 4096] for at in range(0, len(data), 4096))
    packed = [lz4.block.compress(block, store_size=False) for block in blocks]
    return b"".join(len(part).to_bytes(2, "big") + part for part in packed)


def minutes(degrees: float) -> float:
    """Return degrees and minutes (ddmm.mmmm) of degrees."""
    whole = np.trunc(degrees)
    return float(100.0 * whole + 60.0 * (degrees - whole))


def cycles_of(dive: int, step: float = 60.0) -> tuple[list[Cycle], list[Cycle]]:
    """Return the cycles of a dive of ``glider_samples`` and of the surfacing after it: flight, science.

    The mean current is written after the dive, first as an estimate, then finally; the fix is repeated as unchanged.
    """
    track = {
        key: values[made.samples(step)["dive"] == dive]
        for key, values in made.samples(step).items()
    }
    before, after = made.FIXES[2 * dive : 2 * dive + 2]
    east, north = made.mean(dive)
    first = {name: 0.0 for name, _, _ in FLIGHT} | {"m_present_time": made.START + before[0] - 5.0}
    flight: list[Cycle] = [first, _fix(before)]
    science: list[Cycle] = [{name: 0.0 for name, _, _ in SCIENCE}]
    science[0] = {**science[0], "sci_m_present_time": made.START + before[0] - 5.0}
    for time, longitude, latitude, depth in zip(
        *(track[key] for key in ("time", "longitude", "latitude", "depth")), strict=True
    ):
        place = {"m_lat": minutes(latitude), "m_lon": minutes(longitude)}
        flight.append(
            {"m_present_time": time, "m_depth": depth, **place, "m_heading": 1.0, "m_pitch": -0.4}
            | {"c_wpt_lat": 4100.0, "c_wpt_lon": -2930.0, "m_battery": 13.0, "m_altitude": 50.0}
        )
        science.append(
            {
                "sci_m_present_time": time + 2.0,
                # the file has no latitude, so that of 45 degrees is taken
                "sci_water_pressure": gsw.p_from_z(-depth, 45.0) / 10.0,
                "sci_water_temp": 10.0,
                "sci_water_cond": 4.0,
            }
        )
    end = made.START + after[0]
    flight += [
        {"m_present_time": end - 1.0, "m_depth": 0.0},
        _fix(after) | {"m_water_vx": east + 0.05, "m_water_vy": north},
        {"m_present_time": end + 10.0, "m_gps_lat": None, "m_gps_lon": None, "m_depth": 0.0},
        {"m_present_time": end + 20.0, "m_final_water_vx": east, "m_final_water_vy": north},
        {"m_present_time": end + 30.0, "m_gps_lat": 69696969.0, "m_gps_lon": 69696969.0},
    ]
    return flight, science


def _fix(fix: np.ndarray) -> Cycle:
    seconds, longitude, latitude = fix
    return {
        "m_present_time": made.START + seconds,
        "m_gps_lat": minutes(latitude),
        "m_gps_lon": minutes(longitude),
        "m_gps_status": 0.0,
    }


def mission(
    folder: Path, crc: bool = False, vehicle: str = "unit_1", compress: bool = False
) -> list[Path]:
    """Write the mission of two dives, a segment each, and return its files: flight and science of the first, then of the second."""
    folder.mkdir(parents=True, exist_ok=True)
    names = {
        "sbd": ("abcd0001" if crc else "", FLIGHT),
        "tbd": ("abcd0002" if crc else "", SCIENCE),
    }
    for cache, sensors in names.values() if crc else ():
        (folder / "cac").mkdir(exist_ok=True)
        text = sensor_list(sensors)
        (folder / "cac" / f"{cache.upper()}.{'CCC' if compress else 'CAC'}").write_bytes(
            compressed(text) if compress else text
        )
    paths = []
    for dive in (0, 1):
        for (ending, (cache, sensors)), cycles in zip(names.items(), cycles_of(dive), strict=True):
            segment = f"{vehicle}-2023-317-0-{dive}"
            data = file_bytes(sensors, cycles, ">", cache, segment, ending)
            path = folder / f"{segment}.{ending[0] + 'cd' if compress else ending}"
            path.write_bytes(compressed(data) if compress else data)
            paths.append(path)
    return paths
