"""Several vehicles: who goes to which goal, and missions that keep apart."""
