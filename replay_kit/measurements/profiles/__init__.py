"""Profiles: pings turned to true axes, made absolute, and flagged."""
