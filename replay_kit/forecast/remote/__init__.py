"""Forecasts on servers: opened by address, cut to the required part, and cached with their provenance."""
