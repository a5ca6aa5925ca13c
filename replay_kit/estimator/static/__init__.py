"""The static estimate: one forecast time, nothing changes between observations."""
