"""``[[measurements.map]]``: fields of a topic that hold a profile, velocity, position or depth, for messages of unknown type.

A path is field names with dots between them, list indices among them, and ``*`` for every item of a list:
``fix.position.0``, ``cells.*.east``.
"""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from replay_kit.config.file import NotNegative, Positive, Section

_PATH_PART = r"[^.\s][^.]*"
Path = Annotated[str, Field(pattern=rf"^{_PATH_PART}(\.{_PATH_PART})*$")]
AngleUnit = Literal["deg", "rad", "degE7"]
SpeedUnit = Literal["m/s", "dm/s", "cm/s", "mm/s"]
LengthUnit = Literal["m", "dm", "cm", "mm"]
DepthUnit = Literal["m", "dm", "cm", "mm", "dbar", "bar", "Pa", "hPa", "kPa"]


class _Map(Section):
    """Settings common to all maps.

    Attributes:
        topic: Topic whose messages are read in this way, whatever their schema.
        name: Read only messages whose field 'name' is this one, on topics that carry several things under names.
        depth: Path of the vehicle's depth, height or pressure.
        depth_unit: Unit of depth; a unit of pressure makes it a pressure.
        depth_positive: Direction in which depth increases; without effect on a pressure.
        depth_absolute: Whether a pressure includes that of the atmosphere, 1013.25 hPa.
    """

    topic: Annotated[str, Field(min_length=1)]
    name: str | None = None
    depth: Path | None = None
    depth_unit: DepthUnit = "m"
    depth_positive: Literal["down", "up"] = "down"
    depth_absolute: bool = False


class _PlaceMap(_Map):
    """Map that may state a position.

    Attributes:
        dead_reckoned: Whether the position was computed by dead reckoning, not measured.
    """

    longitude: Path | None = None
    latitude: Path | None = None
    angle_unit: AngleUnit = "deg"
    dead_reckoned: bool = False


class PositionMap(_PlaceMap):
    """A topic with positions."""

    kind: Literal["position"]
    longitude: Path
    latitude: Path


class DepthMap(_Map):
    """A topic with depths or pressures."""

    kind: Literal["depth"]
    depth: Path


class ProfileMap(_PlaceMap):
    """A topic with profiles of the current, and with the vehicle's position if the same message holds it; ``depth`` is the instrument's.

    Attributes:
        reference: What the velocities are relative to; there is no default, and with unknown they are not used.
        frame: Frame of the velocity components, in this order.
        velocity: Path of the components, cell after cell, as lists of lists or flat.
        components: Number of components per cell, when velocity is flat.
        east: Path of the eastward velocity, one number per cell; with north instead of velocity.
        velocity_std: Standard error of each component [m/s].
        missing: Numbers in the message that mark a missing velocity, such as -32768.
        depths: Path of the depths of the cells' centres below the surface; depth_positive applies to them.
        distances: Path of the distances of the cells' centres from the instrument, instead of depths.
        cell_size: Size of the cells, a number or a path; with first_cell instead of depths and distances.
        first_cell: Distance from the instrument to the centre of the first cell, a number or a path.
        distance_unit: Unit of depths, distances, cell_size and first_cell.
        orientation: Direction in which the instrument looks.
    """

    kind: Literal["profile"]
    reference: Literal["earth", "platform", "unknown"]
    frame: Literal["enu", "ned", "ship", "instrument", "beam"]
    velocity: Path | None = None
    components: Annotated[int, Field(ge=2)] | None = None
    east: Path | None = None
    north: Path | None = None
    speed_unit: SpeedUnit = "m/s"
    velocity_std: Positive | None = None
    missing: tuple[float, ...] = ()
    depths: Path | None = None
    distances: Path | None = None
    cell_size: float | Path | None = None
    first_cell: float | Path | None = None
    distance_unit: LengthUnit = "m"
    orientation: Literal["down", "up"] = "down"

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if (self.velocity is None) == (self.east is None) or (self.east is None) != (
            self.north is None
        ):
            raise ValueError("give velocity, or east and north")
        if (self.longitude is None) != (self.latitude is None):
            raise ValueError("give longitude and latitude, or neither")
        if self.east is not None and self.frame not in ("enu", "ned"):
            raise ValueError(f"east and north are not in a frame '{self.frame}'; give velocity")
        given = [value is not None for value in (self.depths, self.distances, self.cell_size)]
        if sum(given) != 1 or (self.cell_size is None) != (self.first_cell is None):
            raise ValueError("give one of depths, distances, or cell_size with first_cell")
        if self.depths is not None and self.depth is not None:
            raise ValueError("depths are below the surface; leave out depth, or give distances")
        return self


class VelocityMap(_PlaceMap):
    """A topic with one velocity at one depth, of a current meter, mooring or drifter; ``depth`` is where it was measured.

    With a place of its own (paths, or ``place``) it does not locate the vehicle; without one it was measured at the vehicle.

    Attributes:
        reference: What the velocity is relative to; there is no default, and with unknown it is not used.
        velocity_std: Standard error of each component [m/s].
        missing: Numbers in the message that mark a missing velocity, such as -32768.
        at_depth: Depth of the measurement, where the message does not state it [m].
        distance: Distance of the measurement from the vehicle, as of one cell of its ADCP [m].
        orientation: Direction of distance.
        place: Longitude and latitude of an instrument that does not move [degrees].
    """

    kind: Literal["velocity"]
    reference: Literal["earth", "platform", "unknown"]
    east: Path
    north: Path
    speed_unit: SpeedUnit = "m/s"
    velocity_std: Positive | None = None
    missing: tuple[float, ...] = ()
    at_depth: NotNegative | None = None
    distance: NotNegative | None = None
    orientation: Literal["down", "up"] = "down"
    place: tuple[float, float] | None = None

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if (self.longitude is None) != (self.latitude is None) or (
            self.longitude is not None and self.place is not None
        ):
            raise ValueError("give longitude and latitude, or place, or neither")
        if self.depth is not None and self.at_depth is not None:
            raise ValueError("give depth or at_depth, not both")
        if self.distance is not None and (
            self.elsewhere or self.depth is not None or self.at_depth is not None
        ):
            raise ValueError(
                "distance is counted from the vehicle; leave out depth, at_depth and the place"
            )
        if self.elsewhere and (self.depth is None) == (self.at_depth is None):
            raise ValueError("a velocity with a place of its own needs depth or at_depth")
        if self.place is not None and not (
            -180.0 <= self.place[0] <= 360.0 and abs(self.place[1]) <= 90.0
        ):
            raise ValueError("place is not a longitude and latitude")
        return self

    @property
    def elsewhere(self) -> bool:
        """Whether the instrument has its own position, apart from the vehicle."""
        return self.longitude is not None or self.place is not None


TopicMap = Annotated[PositionMap | DepthMap | ProfileMap | VelocityMap, Field(discriminator="kind")]
