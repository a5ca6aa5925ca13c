"""A result as one HTML page that answers: what was measured, what was found, how sure it is, and what to do next."""
