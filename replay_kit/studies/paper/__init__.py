"""``experiment paper``: the study of Kong, To, Brassington, Anstee, Fitch (IROS 2021) on any ensemble."""
