"""HTML pages of sections with text and figures, for reports on results and studies."""
