"""Sections of text and figures as one HTML page, for the reports of results and of studies alike."""

from replay_kit.show.page.page import page_html
from replay_kit.show.page.section import Control, Figure, Section

__all__ = ["Control", "Figure", "Section", "page_html"]
