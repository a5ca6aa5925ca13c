"""Studies of planning on twin missions."""
