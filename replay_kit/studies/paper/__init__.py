"""``experiment paper``: the study of Kong, To, Brassington, Anstee, Fitch (IROS 2021) on any ensemble."""

from replay_kit.studies.paper.run import PaperJob, run_paper

__all__ = ["PaperJob", "run_paper"]
