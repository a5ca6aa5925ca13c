"""Forecasts on servers: opened by their address, cut to what is needed, and kept here with a record of where they came from."""
