"""Windows that follow vehicles: each has its own estimator and hands its information over to the next."""
