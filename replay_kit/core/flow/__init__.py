"""Estimate of the current: velocity, standard error, samples, and their NetCDF form."""
