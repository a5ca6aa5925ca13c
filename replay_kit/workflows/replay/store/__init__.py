"""States on the disk, from which a run resumes, and built estimators that runs share."""
