"""``bench``: tasks on real and simulated missions, the methods and programs that do them, and their scores in one table."""
