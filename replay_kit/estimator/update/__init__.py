"""What an observation does to the estimate."""
