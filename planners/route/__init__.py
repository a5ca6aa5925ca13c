"""Routes: the quickest way of a front round obstacles, and the bound of the time that a mission takes."""
