"""Several vehicles in one estimate: who goes where, missions that keep apart."""
