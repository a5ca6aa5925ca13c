"""What a statement changes in the state of the measurement step, and the events that it gives."""
