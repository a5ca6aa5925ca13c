"""Geostrophic shear of the current across a line of profiles from the vehicle's own density."""
