"""One number of legs solved, held clear of obstacles, flown and checked."""
