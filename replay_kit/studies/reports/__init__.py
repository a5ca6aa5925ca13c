"""What the studies share of their output: tables, files, pictures, failures, progress."""
