"""``bench``: tasks on real and simulated missions, the methods and programs that do them, and their scores in one table."""

from replay_kit.studies.bench.run import TASKS, BenchJob, run_bench

__all__ = ["TASKS", "BenchJob", "run_bench"]
