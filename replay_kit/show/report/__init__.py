"""A result as one HTML page that answers: what was measured, what was found, how sure it is, and what to do next."""

from replay_kit.show.report.pages import report_html

__all__ = ["report_html"]
