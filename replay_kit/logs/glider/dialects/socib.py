"""The SOCIB glider toolbox, L1 and L2."""

from replay_kit.logs.glider.dialect import Dialect
from replay_kit.logs.glider.dialects.pyglider import DIALECT as PYGLIDER

DIALECT = Dialect(
    "socib",
    "SOCIB glider toolbox (L1, L2)",
    "time latitude longitude water_velocity_eastward water_velocity_northward",
    PYGLIDER.names,
)
