"""What a replay reads: the job, its logs scanned, the part of the forecast, the estimator, and what a result says of them."""
