"""The estimate of the current as a value: velocity, standard error, samples, and its NetCDF form."""
