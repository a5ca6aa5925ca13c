"""Grids: where the velocities of a file lie, horizontally and in depth, and along which axes."""
