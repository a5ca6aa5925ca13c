"""A result shown: report, status, plots, exports, and the value that a notebook holds. Nothing here is estimated or planned."""
