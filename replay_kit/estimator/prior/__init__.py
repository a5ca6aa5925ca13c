"""What is known before any observation, and how it is fitted to an ensemble."""
