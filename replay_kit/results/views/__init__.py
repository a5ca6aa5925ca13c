"""Values taken out of an opened result, for reports, figures and exports alike: pure arrays, thinned to what can be shown."""
