"""One log end to end."""
