"""Windows that follow the vehicle: each is an estimator of its own, and hands over its information to the next."""
