"""What the studies share of running: options checked, progress counted, failures kept as results."""
