"""Currents at the surface: by HF radar, and by drifters."""
