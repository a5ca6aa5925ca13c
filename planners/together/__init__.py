"""Several vehicles in one estimate: who goes where, missions that keep apart, a box that all of them survey."""
