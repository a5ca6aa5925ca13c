"""replay-kit: what was the water doing, and where should the vehicle go next?"""

__version__ = "0.1.0"
