"""Identification of variables, dimensions and coordinates, by CF standard names first, then by the names that producers use."""

from collections.abc import Hashable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import xarray as xr

from replay_kit.core.errors import ForecastError
from replay_kit.core.words.text import some_text

Axes = Literal["true", "grid"]

MEMBER_NAMES = (
    "member",
    "ensemble",
    "ens",
    "number",
    "realization",
    "ensemble_member",
    "member_id",
    "record",
)
_LEAD_NAMES = ("lead", "lead_time", "leadtime", "step", "forecast_period")
_TIME_NAMES = ("time", "valid_time", "time_counter", "ocean_time", "scrum_time", "mt", "t")
_DEPTH_NAMES = (
    "depth",
    "lev",
    "level",
    "deptht",
    "depthu",
    "depthv",
    "z",
    "z_l",
    "st_ocean",
    "elevation",
    "zt",
    "zc",
    "z_t",
    "k",
    "zl",
    "s_rho",
    "sc_r",
    "nav_lev",
    "olevel",
)
_VELOCITY_STANDARD_NAMES: tuple[tuple[str, str, Axes], ...] = (
    ("eastward_sea_water_velocity", "northward_sea_water_velocity", "true"),
    ("sea_water_x_velocity", "sea_water_y_velocity", "grid"),
    ("sea_water_x_velocity_at_u_location", "sea_water_y_velocity_at_v_location", "grid"),
)
# Where a current goes to, the older name second; and where it comes from.
_DIRECTIONS = (
    "sea_water_velocity_to_direction",
    "direction_of_sea_water_velocity",
    "sea_water_velocity_from_direction",
)
# Where a name alone says nothing of the axes, they follow from the grid.
_VELOCITY_SHORT_NAMES: tuple[tuple[str, str, Axes | None], ...] = (
    ("u_eastward", "v_northward", "true"),
    ("water_u", "water_v", "true"),
    ("eastward_eulerian_current_velocity", "northward_eulerian_current_velocity", "true"),
    ("ucur", "vcur", "true"),
    ("vozocrtx", "vomecrty", "grid"),
    ("vxo", "vyo", "grid"),
    ("UVEL", "VVEL", "grid"),
    ("uo", "vo", None),
    ("u", "v", None),
    ("U", "V", None),
)
# Statistics of several members in a file of members by suffix.
_NO_MEMBERS = ("mean", "std", "stdev", "spread", "var", "min", "max", "anom")


@dataclass(frozen=True, slots=True)
class Coordinates:
    """Names of the coordinates and masks of one kind of grid.

    Attributes:
        dialect: Name of the kind of files.
        longitude: Longitude of the current's final points: cell centres, or the corners of a B-grid.
        latitude: Latitude of the same points.
        mask: Variables above 0 in water at cell centres.
        mask_u: Variables above 0 in water at faces of u.
        mask_v: Variables above 0 in water at faces of v.
        face: Side of the centre i on which u[i] lies on a C-grid: +1 east, -1 west.
    """

    dialect: str
    longitude: tuple[str, ...]
    latitude: tuple[str, ...]
    mask: tuple[str, ...] = ()
    mask_u: tuple[str, ...] = ()
    mask_v: tuple[str, ...] = ()
    face: Literal[1, -1] = 1


_NEMO = Coordinates(
    "NEMO",
    ("glamt",),
    ("gphit",),
    ("tmask", "tmaskutil"),
    ("umask", "umaskutil"),
    ("vmask", "vmaskutil"),
)
# The first whose longitude and latitude are in the file is taken; more particular ones first.
COORDINATES = (
    Coordinates(
        "ROMS or CROCO", ("lon_rho",), ("lat_rho",), ("mask_rho",), ("mask_u",), ("mask_v",)
    ),
    _NEMO,
    Coordinates(
        "MITgcm", ("XC",), ("YC",), ("hFacC", "maskC"), ("hFacW", "maskW"), ("hFacS", "maskS"), -1
    ),
    Coordinates("MOM6", ("geolon", "xh"), ("geolat", "yh"), ("wet",), ("wet_u",), ("wet_v",)),
    Coordinates("MOM5 (B-grid)", ("geolon_c", "xu_ocean"), ("geolat_c", "yu_ocean")),
    Coordinates("POP (B-grid)", ("ULON", "ULONG"), ("ULAT",), ("KMU",)),
    replace(_NEMO, longitude=("nav_lon",), latitude=("nav_lat",)),
    Coordinates(
        "CF",
        ("longitude", "lon"),
        ("latitude", "lat"),
        ("mask", "land_sea_mask", "sea_binary_mask"),
    ),
)
#: Number of wet levels of each column, from the surface.
LEVEL_COUNTS = ("num_levels", "mbathy", "kmt", "KMT", "kmu", "KMU")
SEA_LEVEL = (
    "zeta",
    "zos",
    "ssh",
    "surf_el",
    "sossheig",
    "zeta_detided",
    "eta_t",
    "Eta",
    "ETAN",
    "adt",
    "sla",
    "SSH",
)
ANGLES = ("angle", "CS", "AngleCS", "ANGLE", "cos_rot", "COSROT")


def _by_standard_name(ds: xr.Dataset, standard_name: str) -> list[str]:
    return [
        str(name)
        for name, variable in ds.variables.items()
        if variable.attrs.get("standard_name") == standard_name
    ]


@dataclass(frozen=True, slots=True)
class Current:
    """Velocity components of a file.

    Attributes:
        u: Name of the first component; None if the file holds only the second.
        v: Name of the second component.
        axes: Axes of the components; None if no name states them.
        why: Reason for the axes.
        direction: Name of the direction of a current stated as speed, for which both components stand, and direction.
        turn: Offset added to obtain the direction towards which the current flows [degrees].
    """

    u: str | None
    v: str | None
    axes: Axes | None
    why: str
    direction: str | None = None
    turn: float = 0.0


def find_current(ds: xr.Dataset, where: str) -> Current | None:
    """Return the velocity components of a file; None without a current.

    Raises:
        ForecastError: Several variables have the same standard name, and none has a usual short name.
    """
    pairs: list[Current] = []
    short = {name for u, v, _ in _VELOCITY_SHORT_NAMES for name in (u, v)}
    for east, north, axes in _VELOCITY_STANDARD_NAMES:
        found = []
        for standard_name in (east, north):
            names = _by_standard_name(ds, standard_name)
            if len(names) > 1:
                usual = [name for name in names if name in short]
                if len(usual) != 1:
                    raise ForecastError(
                        f"{where}: several variables have the standard name {east} or {north}: {names}; leave one of each, or give "
                        "--members suffix"
                    )
                names = usual
            found.append(names[0] if names else None)
        pairs.append(Current(found[0], found[1], axes, f"standard name {east}"))
    for east, north, of_name in _VELOCITY_SHORT_NAMES:
        u, v = (name if name in ds.variables else None for name in (east, north))
        pairs.append(Current(u, v, of_name, f"name {east}"))
    for turn, towards in enumerate(_DIRECTIONS):
        speed, angle = _by_standard_name(ds, "sea_water_speed"), _by_standard_name(ds, towards)
        if speed and angle:
            why = f"{speed[0]} and {angle[0]}"
            pairs.append(Current(speed[0], speed[0], "true", why, angle[0], 180.0 * (turn > 1)))
    present = [pair for pair in pairs if pair.u or pair.v]
    return next((pair for pair in present if pair.u and pair.v), present[0] if present else None)


def suffixes(ds: xr.Dataset) -> tuple[dict[str, tuple[str, str]], list[str]]:
    """Return the components of members by the suffix of their names, without statistics; and those that lack the other component."""
    found, alone = dict[str, tuple[str, str]](), dict[str, str]()
    for name in map(str, ds.data_vars):
        for u, v, _ in _VELOCITY_SHORT_NAMES:
            ending = name.removeprefix(f"{u}_").removeprefix(f"{v}_")
            if ending == name or ending.lower() in _NO_MEMBERS:
                continue
            pair = f"{u}_{ending}", f"{v}_{ending}"
            missing = [other for other in pair if other not in ds.variables]
            if missing:
                alone[ending] = f"{name} without {missing[0]}"
            else:
                found.setdefault(ending, pair)
    # of a single field a variable of a like name is no member
    lone = [text for ending, text in alone.items() if ending not in found]
    return found, lone if len(found) > 1 else []


def sizes_text(held: xr.Dataset | xr.DataArray) -> str:
    """Return dimensions and sizes as text, such as ``depth = 4, lat = 5``."""
    return ", ".join(f"{dim} = {size}" for dim, size in held.sizes.items())


class NoCurrentError(ForecastError):
    """Error for files without a current: expected names and existing variables."""

    def __init__(self, datasets: Sequence[xr.Dataset], where: str) -> None:
        names = {str(name) for ds in datasets for name in ds.data_vars}
        self.variables = some_text(sorted(names))
        usual = ", ".join(f"{u}/{v}" for u, v, _ in _VELOCITY_SHORT_NAMES)
        super().__init__(
            f"{where}: no current found; expected variables with standard names eastward_/northward_sea_water_velocity or "
            f"sea_water_x_/y_velocity, or named {usual}; got {self.variables or 'no variable'}"
        )


def find_coordinates(
    ds: xr.Dataset, dims: Iterable[Hashable], where: str
) -> tuple[str, str, Coordinates]:
    """Return the names of longitude and latitude, in one or two dimensions, and the kind of grid.

    Args:
        ds: Dataset of a file, with variables of grid files.
        dims: Dimensions of both velocity components; coordinates of one alone, as of u on a C-grid, are not at the centres.
        where: Name of the file, for messages.

    Raises:
        ForecastError: The coordinates are missing.
    """
    by_kind = [
        (longitude, latitude, kind)
        for kind in COORDINATES
        for longitude, latitude in zip(kind.longitude, kind.latitude, strict=False)
    ]
    by_standard_name = [
        (longitude, latitude, COORDINATES[-1])
        for longitude in _by_standard_name(ds, "longitude")
        for latitude in _by_standard_name(ds, "latitude")
    ]
    # those that a topology after SGRID 0.3 names as the centres' come first
    topologies = [
        variable.attrs for variable in ds.variables.values() if "face_dimensions" in variable.attrs
    ]
    centres = " ".join(about.get("face_coordinates", "") for about in topologies).split()
    by_standard_name.sort(key=lambda found: not {*found[:2]} <= {*centres})
    usual = {longitude for longitude, _, kind in by_kind if kind is not COORDINATES[-1]}
    by_topology = [
        found
        for found in by_standard_name
        if found[0] not in usual
        and {dim for name in found[:2] for dim in ds[name].dims} <= set(dims)
    ]
    for found in (*by_topology, *by_kind):
        if set(found[:2]) <= set(ds.variables) and ds[found[0]].ndim in (1, 2, 3):
            return found
    if by_standard_name:
        return by_standard_name[0]
    there = [name for name in ("longitude", "latitude") if not _by_standard_name(ds, name)]
    raise ForecastError(
        f"{where}: no {there[0] if there else 'longitude'} found; expected standard names longitude and latitude, or one of "
        f"{', '.join('/'.join(found[:2]) for found in by_kind)}; "
        "give the file of the grid with --ensemble too"
    )


def find_dimension(
    ds: xr.Dataset,
    dims: Iterable[Hashable],
    standard_names: tuple[str, ...],
    names: tuple[str, ...],
) -> str | None:
    """Return the dimension with a coordinate of a standard name, else one with a short name, else None."""
    found = [str(dim) for dim in dims]
    for dim in found:
        if dim in ds.variables and ds.variables[dim].attrs.get("standard_name") in standard_names:
            return dim
    lowered = {dim.lower(): dim for dim in found}
    return next((lowered[name] for name in names if name in lowered), None)


def find_member(ds: xr.Dataset, dims: Iterable[Hashable]) -> str | None:
    """Return the ensemble dimension, or None."""
    axis = next(
        (
            str(dim)
            for dim in dims
            if dim in ds.variables and ds.variables[dim].attrs.get("axis") == "E"
        ),
        None,
    )
    return axis or find_dimension(ds, dims, ("realization",), MEMBER_NAMES)


def find_depth(ds: xr.Dataset, dims: Iterable[Hashable]) -> str | None:
    """Return the depth dimension, or None."""
    return find_dimension(ds, dims, ("depth", "height"), _DEPTH_NAMES)


def find_lead(ds: xr.Dataset, dims: Iterable[Hashable]) -> str | None:
    """Return the dimension of forecast periods, or None."""
    return find_dimension(ds, dims, ("forecast_period",), _LEAD_NAMES)


def find_time(ds: xr.Dataset, dims: Iterable[Hashable]) -> str | None:
    """Return the dimension of times, or None."""
    return find_dimension(ds, dims, ("time",), _TIME_NAMES)


#: Name of the share of the water above terrain-following levels, from -1 at the sea bed to 0, where a file of a mesh has it.
SHARE = "replay_kit_share"
#: Attribute of a dataset of a mesh that was interpolated to a grid: what was done, and what error it makes.
MESH = "replay_kit_mesh"
# Names of the corners of faces, longitude and latitude where no topology is stated: FVCOM, SCHISM, FESOM.
_MESHES = (
    ("nv", "lon", "lat"),
    ("SCHISM_hgrid_face_nodes", "SCHISM_hgrid_node_x", "SCHISM_hgrid_node_y"),
    ("face_nodes", "lon", "lat"),
    ("elements", "lon", "lat"),
)


def find_mesh(ds: xr.Dataset) -> tuple[str, str, str] | None:
    """Return the names of face corners and node longitude and latitude of an unstructured mesh; None without a mesh.

    Source: UGRID conventions 1.0, two-dimensional flexible mesh.
    """
    for variable in ds.variables.values():
        about = variable.attrs
        if about.get("cf_role") == "mesh_topology" and "face_node_connectivity" in about:
            x, y = about["node_coordinates"].split()
            if "lat" in str(ds[x].attrs.get("standard_name", "")):
                x, y = y, x
            return about["face_node_connectivity"], x, y
    return next((names for names in _MESHES if set(names) <= set(ds.variables)), None)
