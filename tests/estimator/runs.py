"""Logs passed through an estimator one observation at a time, as online."""


def run(estimator, observations, state=None):
    """Return the last state, and all innovations."""
    state, innovations = state or estimator.initial(), []
    for observation in observations:
        state, innovation = estimator.step(state, observation)
        innovations.append(innovation)
    return state, innovations


def after(estimator, observations, state=None):
    """Return the last state."""
    return run(estimator, observations, state)[0]
