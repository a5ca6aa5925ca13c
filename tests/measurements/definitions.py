"""Fields of other packages' messages, as their definitions declare them, for logs made by the tests.

| message | read in |
|---|---|
| ds_sensor_msgs/Adcp, WaterCurrentProfile | Field-Robotics-Lab/ds_msgs 0e5b004 |
| marine_acoustic_msgs/Dvl | apl-ocean-engineering/marine_msgs |
| CurrentProfile, CurrentProfileCell, ADCPBeam | LSTS/imc IMC.xml, messages 1014 to 1016 |
| sensor_msgs, nav_msgs, geometry_msgs | ROS common interfaces |
"""

_LINE = "=" * 80


def definition(*parts: str) -> str:
    """Return a definition with those of the types that it uses."""
    return "\n".join((parts[0], *(f"{_LINE}\nMSG: {part}" for part in parts[1:])))


HEADER_2 = "std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id"
VECTOR = "geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z"

_ADCP = """std_msgs/Header header
ds_core_msgs/DsHeader ds_header
uint8 ADCP_COORD_BEAM=0
uint8 ADCP_COORD_INSTRUMENT=1
uint8 ADCP_COORD_SHIP=2
uint8 ADCP_COORD_EARTH=3
uint8 coordinate_mode
uint8 adcp_type
uint8 cells
uint16 cell_depth
float32 bin0_distance
geometry_msgs/Vector3[4] beam_unit_vec
ds_sensor_msgs/WaterCurrentProfile[] vel_bin_beams"""
_WATER_CURRENT_PROFILE = (
    "ds_sensor_msgs/WaterCurrentProfile\ngeometry_msgs/Vector3[] velocity_bin_beam"
)
DS_ADCP_2 = definition(
    _ADCP,
    HEADER_2,
    "ds_core_msgs/DsHeader\nbuiltin_interfaces/Time io_time\nuint8[16] source_uuid",
    VECTOR,
    _WATER_CURRENT_PROFILE,
)
NAV_SAT_FIX = definition(
    """std_msgs/Header header
sensor_msgs/NavSatStatus status
float64 latitude
float64 longitude
float64 altitude
float64[9] position_covariance
uint8 position_covariance_type""",
    HEADER_2,
    "sensor_msgs/NavSatStatus\nint8 status\nuint16 service",
)
FLUID_PRESSURE = definition(
    "std_msgs/Header header\nfloat64 fluid_pressure\nfloat64 variance", HEADER_2
)
# our own ping as a ROS 2 message: what may be unknown is NaN, velocity flat
ADCP_PING = """builtin_interfaces/Time stamp
string frame_id
uint64 ping
string coordinate_system
string reference
string orientation
bool bin_mapped
uint32 n_cells
float64 cell_size
float64 bin0_distance
float64 transducer_depth
float64[] velocity
float64[] velocity_std
float64 sound_speed
float64 temperature
float64 pressure
float64 heading
float64 pitch
float64 roll
float64 magnetic_declination
bool declination_applied"""
