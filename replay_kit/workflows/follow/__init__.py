"""Following of growing logs."""
