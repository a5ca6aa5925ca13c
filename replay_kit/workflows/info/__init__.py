"""What a log holds, and whether it was probably made with a fault."""
