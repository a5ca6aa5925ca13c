"""Whether the measurements of a log contradict each other."""
