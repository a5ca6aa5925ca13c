"""HTML reports on results: observations, estimate, uncertainty and next steps."""
