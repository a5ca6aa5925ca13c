"""Missions by multiple shooting: the current near many vehicles at once, their paths with exact derivatives, the callbacks of IPOPT."""
