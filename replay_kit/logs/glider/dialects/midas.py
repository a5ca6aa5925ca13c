"""Nortek's AD2CP on a glider, exported by MIDAS: pings alone."""

from replay_kit.logs.glider.ad2cp import midas_pings
from replay_kit.logs.glider.dialect import Dialect

DIALECT = Dialect(
    "midas",
    "Nortek AD2CP exported by MIDAS",
    "time velocitybeam1 velocitybeam2 heading pitch roll",
    {"time": "time"},
    heading="magnetic",
    beside=(
        "velocity",
        "correlation",
        "amplitude",
        "heading",
        "pitch",
        "roll",
        "pressure",
        "speedofsound",
        "accelerometerz",
        "temperature",
    ),
    pings=midas_pings,
)
