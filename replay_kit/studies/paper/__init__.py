"""The study of the paper (Kong, To, Brassington, Anstee, Fitch, IROS 2021) on any ensemble."""

from replay_kit.studies.paper.run import PaperJob, PaperTables, Shown, check_folder, run_paper
from replay_kit.studies.paper.write import FILES, print_paper, to_json, write_paper

__all__ = ["FILES", "PaperJob", "PaperTables", "Shown", "check_folder", "print_paper", "run_paper", "to_json", "write_paper"]
