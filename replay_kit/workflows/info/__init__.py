"""What a log holds and whether it can be believed."""
