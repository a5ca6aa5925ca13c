"""Twin logs with a fault planted in their messages, as a careless logger would have written them."""

import math

import numpy as np

DECLINATION = 14.0


def _each(payload, change):
    cells = [
        [math.nan if value is None else value for value in cell[:2]] for cell in payload["velocity"]
    ]
    return {
        **payload,
        "velocity": [
            [None if math.isnan(v) else v for v in change(cell)] + [None]
            for cell in np.array(cells).tolist()
        ],
    }


def _turned(payload, degrees):
    """Return a ping whose velocities point ``degrees`` further clockwise."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return _each(payload, lambda v: [c * v[0] + s * v[1], c * v[1] - s * v[0]])


def _scaled(payload, factor, with_errors):
    std = payload["velocity_std"] * (factor if with_errors else 1.0)
    return {**_each(payload, lambda v: [factor * v[0], factor * v[1]]), "velocity_std": std}


PINGS = {
    "sound": lambda p: p,
    "east and north are exchanged": lambda p: _each(p, lambda v: v[::-1]),
    "the sign of east is wrong": lambda p: _each(p, lambda v: [-v[0], v[1]]),
    "the sign of north is wrong": lambda p: _each(p, lambda v: [v[0], -v[1]]),
    "both signs are wrong": lambda p: _each(p, lambda v: [-v[0], -v[1]]),
    "the declination was not applied": lambda p: _turned(p, -DECLINATION),
    "the declination was applied twice": lambda p: _turned(p, DECLINATION),
    "speeds are in cm/s": lambda p: _scaled(p, 100.0, False),
    "speeds are in cm/s, errors too": lambda p: _scaled(p, 100.0, True),
    "speeds are in mm/s": lambda p: _scaled(p, 1000.0, False),
    "speeds are in mm/s, errors too": lambda p: _scaled(p, 1000.0, True),
    "speeds are 100 times too small": lambda p: _scaled(p, 0.01, False),
    "speeds are 1000 times too small": lambda p: _scaled(p, 0.001, True),
    "the sign of depth is wrong: pressure": lambda p: {
        **p,
        "pressure": -p["pressure"],
        "orientation": "up",
    },
    "the sign of depth is wrong: orientation": lambda p: {**p, "orientation": "up"},
}
NAMES = {name: name.split(":")[0].split(",")[0] for name in PINGS}
NAMES["both signs are wrong"] = "turned by +180 degrees clockwise, both signs wrong"


def planted(messages, fault):
    """Yield a twin's messages with a fault planted in its pings, which all state the declination."""
    for message in messages:
        if message.schema == "replay_kit.AdcpPing":
            payload = {**message.payload, "magnetic_declination": DECLINATION}
            yield message._replace(payload=PINGS[fault](payload))
        else:
            yield message
