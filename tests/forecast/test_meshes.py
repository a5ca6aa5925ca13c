"""Forecasts on unstructured meshes, made of one known field: on the regular grid it is the same, and nothing crosses the coast."""

import numpy as np
import pytest
import xarray as xr
from scipy.spatial import Delaunay

from tests.forecast import forms
from tests.forecast.forms import refused

WEST, SOUTH, SIDE = -5.0, 48.0, 0.5
LEVELS = np.array([2.0, 10.0, 30.0])


def of_members(lon, lat, depth):
    """Components of two members of the known field, shape (2, 2, ...)."""
    return np.swapaxes([forms.truth(lon, lat, depth, member) for member in (0, 1)], 0, 1)


def is_land(lon, lat, radius=0.15):
    return np.hypot((lon - WEST) / SIDE - 0.5, (lat - SOUTH) / SIDE - 0.5) < radius


@pytest.fixture(scope="module")
def mesh():
    """Nodes (longitude, latitude) and triangles of a square with an island."""
    edge = np.linspace(0.0, 1.0, 30)
    frame = [(a, b) for a in edge for b in edge if {a, b} & {0.0, 1.0}]
    unit = np.vstack([frame, np.random.default_rng(1).uniform(0.02, 0.98, (1500, 2))])
    nodes = np.array([WEST, SOUTH]) + SIDE * unit
    nodes = nodes[~is_land(*nodes.T)]
    triangles = Delaunay(nodes).simplices
    return nodes, triangles[~is_land(*nodes[triangles].mean(axis=1).T)]


def bottom(nodes):
    return 60.0 + 40.0 * (nodes[:, 0] - WEST) / SIDE


def fvcom(nodes, triangles):
    # closer at the surface in the east: shares of the water differ from node to node
    share = ((np.arange(20) + 0.5) / 20)[:, None] ** (1.0 + 0.4 * (nodes[:, 0] - WEST) / SIDE)
    middle = nodes[triangles].mean(axis=1)
    u, v = of_members(*middle.T, (share * bottom(nodes))[:, triangles].mean(axis=2))
    terms = {"standard_name": "ocean_sigma_coordinate"}
    return xr.Dataset(
        {
            "lon": ("node", nodes[:, 0]),
            "lat": ("node", nodes[:, 1]),
            "nv": (("three", "nele"), triangles.T + 1),
            "h": ("node", bottom(nodes)),
            "zeta": (("member", "node"), np.zeros((2, len(nodes)))),
            "siglay": (("siglay", "node"), -share, terms),
            "member": ("member", [0, 1]),
            "u": (("member", "siglay", "nele"), u),
            "v": (("member", "siglay", "nele"), v),
        }
    )


def delft3d(nodes, triangles):
    """By UGRID, with faces of four corners, too, at fixed depths."""
    faces = np.column_stack([triangles + 1, np.full(len(triangles), -999)]).astype(float)
    u, v = of_members(*nodes[triangles].mean(axis=1).T, LEVELS[:, None])
    return xr.Dataset(
        {
            "mesh2d": (
                (),
                0,
                {
                    "cf_role": "mesh_topology",
                    "node_coordinates": "mesh2d_node_x mesh2d_node_y",
                    "face_node_connectivity": "mesh2d_face_nodes",
                },
            ),
            "mesh2d_node_x": ("mesh2d_nNodes", nodes[:, 0], {"standard_name": "longitude"}),
            "mesh2d_node_y": ("mesh2d_nNodes", nodes[:, 1], {"standard_name": "latitude"}),
            "mesh2d_face_nodes": (("mesh2d_nFaces", "corners"), faces, {"start_index": 1}),
            "depth": ("depth", LEVELS, {"positive": "down", "units": "m"}),
            "member": ("member", [0, 1]),
            "mesh2d_ucx": (
                ("member", "mesh2d_nFaces", "depth"),
                u.swapaxes(1, 2),
                {"standard_name": "sea_water_x_velocity"},
            ),
            "mesh2d_ucy": (
                ("member", "mesh2d_nFaces", "depth"),
                v.swapaxes(1, 2),
                {"standard_name": "sea_water_y_velocity"},
            ),
        }
    )


def schism(nodes, triangles):
    """With the heights of the layers at each node."""
    share = np.linspace(1.0, 0.0, 25)
    heights = -bottom(nodes)[:, None] * share
    u, v = of_members(*nodes.T[..., None], -heights)
    dims = ("member", "nSCHISM_hgrid_node", "nSCHISM_vgrid_layers")
    return xr.Dataset(
        {
            "SCHISM_hgrid_node_x": (dims[1], nodes[:, 0]),
            "SCHISM_hgrid_node_y": (dims[1], nodes[:, 1]),
            "SCHISM_hgrid_face_nodes": (("nSCHISM_hgrid_face", "three"), triangles + 1),
            "member": ("member", [0, 1]),
            "zCoordinates": (dims, [heights] * 2),
            "horizontalVelX": (dims, u),
            "horizontalVelY": (dims, v),
        }
    )


def fesom(nodes, triangles):
    u, v = of_members(*nodes[triangles].mean(axis=1).T, LEVELS[:, None])
    return xr.Dataset(
        {
            "lon": ("nod2", nodes[:, 0]),
            "lat": ("nod2", nodes[:, 1]),
            "elements": (("n3", "elem"), triangles.T + 1),
            "nz1": ("nz1", LEVELS, {"positive": "down", "units": "m", "standard_name": "depth"}),
            "member": ("member", [0, 1]),
            "u": (("member", "nz1", "elem"), u),
            "v": (("member", "nz1", "elem"), v),
        }
    )


@pytest.mark.parametrize("made", [fvcom, delft3d, schism, fesom])
def test_a_field_on_a_mesh_is_the_same_on_the_grid(tmp_path, mesh, made):
    made(*mesh).to_netcdf(tmp_path / "mesh.nc", engine="h5netcdf")
    found = forms.read_with(tmp_path / "mesh.nc", levels=tuple(LEVELS))
    grid = found.grid
    np.testing.assert_array_equal(grid.levels, LEVELS)
    # of the mean spacing of the mesh
    assert 0.5 * len(mesh[0]) < grid.wet[0].sum() < 2.0 * len(mesh[0])
    forms.assert_comes_back(found, 0.01, n_members=2)
    # a triangle may reach across the coast by its own size
    assert not (grid.wet & is_land(grid.longitude, grid.latitude, 0.12)).any()
    assert "cm/s RMS" in found.notes[-1]


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda ds: ds.assign(lon=1e4 * ds.lon), "whose nodes are not in degrees"),
        (lambda ds: ds.drop_vars("h"), r"layers siglay need the depth of the bottom \(h\)"),
    ],
)
def test_meshes_that_cannot_be_read_are_refused(tmp_path, mesh, spoil, words):
    spoil(fvcom(*mesh)).to_netcdf(tmp_path / "mesh.nc", engine="h5netcdf")
    refused(words, tmp_path / "mesh.nc")
