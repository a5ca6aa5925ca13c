"""The earliest arrival: a front that spreads over a lattice through a changing current and round obstacles, and the routes along it."""
