from replay_kit.core.progress import announce, counted, shown_by


def test_what_is_announced_goes_to_whoever_shows_it_and_to_nobody_else():
    outer, inner = [], []
    announce("nobody looks")
    with shown_by(lambda *told: outer.append(told)):
        announce("one")
        with shown_by(lambda *told: inner.append(told)):
            announce("two", 1, 3)
        announce("three", 2)
    announce("nobody looks")
    assert outer == [(0, 0, "one"), (2, 0, "three")]
    assert inner == [(1, 3, "two")]


def test_steps_are_counted():
    told = []
    with shown_by(lambda *step: told.append(step)):
        advance = counted("fitting", 2)
        advance()
        advance()
    assert told == [(1, 2, "fitting"), (2, 2, "fitting")]
