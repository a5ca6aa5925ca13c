"""The study of the paper (Kong, To, Brassington, Anstee, Fitch, IROS 2021) on any ensemble."""

from replay_kit.studies.paper.page import FILES, print_paper, to_json, write_paper
from replay_kit.studies.paper.run import PaperJob, PaperTables, Shown, run_paper

__all__ = [
    "FILES",
    "PaperJob",
    "PaperTables",
    "Shown",
    "print_paper",
    "run_paper",
    "to_json",
    "write_paper",
]
