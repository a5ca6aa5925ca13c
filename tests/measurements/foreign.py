"""Payloads of other packages' messages, as their decoders give them."""

import math

UNIT = math.sqrt(0.5)
BEAMS = [(UNIT, 0.0, UNIT), (-UNIT, 0.0, UNIT), (0.0, UNIT, UNIT), (0.0, -UNIT, UNIT)]


def vectors(rows):
    return [dict(zip("xyz", row, strict=True)) for row in rows]


CELLS = ((0.1, -0.2, 0.01), (0.0, 0.0, 0.0), (0.3, 0.0, 0.0))


def ds_adcp(mode=3, cell_depth=2):
    read = [[cell] if mode else [cell] * 4 for cell in CELLS]
    return {
        "coordinate_mode": mode,
        "cells": len(read),
        "cell_depth": cell_depth,
        "bin0_distance": 3.5,
        "beam_unit_vec": vectors(BEAMS),
        "vel_bin_beams": [{"velocity_bin_beam": vectors(rows)} for rows in read],
    }


def imc(coord_sys, cells, distance=5.0):
    profile = [
        {
            "abbrev": "CurrentProfileCell",
            "cell_position": distance * (k + 1),
            "beams": [{"vel": v, "amp": 60.0, "cor": 90} for v in cell],
        }
        for k, cell in enumerate(cells)
    ]
    return {
        "abbrev": "CurrentProfile",
        "timestamp": 12.5,
        "nbeams": 4,
        "ncells": len(cells),
        "coord_sys": coord_sys,
        "profile": profile,
    }


def pose(x, y, z, frame="odom", turn=None):
    return {
        "header": {"frame_id": frame},
        "pose": {"position": {"x": x, "y": y, "z": z}, "orientation": turn or {"w": 1.0}},
    }
