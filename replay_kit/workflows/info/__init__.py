"""Contents of logs, and checks for faults of their making."""
