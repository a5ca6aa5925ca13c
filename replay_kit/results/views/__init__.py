"""Values of an opened result for reports, figures and exports: pure arrays, thinned for display."""
