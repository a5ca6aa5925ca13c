"""Quality control of profiles, and faults of whole logs."""
