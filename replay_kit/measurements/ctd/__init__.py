"""A vehicle's own density along its way: the geostrophic shear of the current across a line of profiles."""
