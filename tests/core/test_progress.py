"""Stages announced, and calls made by whoever is given them."""

from replay_kit.core.words.progress import announce, called_by, counted, each_call, shown_by


def test_what_is_announced_goes_to_whoever_shows_it_and_to_nobody_else():
    outer, inner = [], []
    announce("nobody looks")
    with shown_by(lambda *told: outer.append(told)):
        announce("one")
        with shown_by(lambda *told: inner.append(told)):
            announce("two", 1, 3)
        advance = counted("three", 1)
        advance()
    announce("nobody looks")
    assert outer == [(0, 0, "one"), (1, 1, "three")]
    assert inner == [(1, 3, "two")]


def test_calls_are_made_one_by_one_when_their_values_are_asked_for():
    made = []
    values = each_call(lambda a, b: made.append(a) or a + b, ((a, 10) for a in (1, 2, 3)))
    assert made == []
    assert next(values) == 11
    assert made == [1]
    assert list(values) == [12, 13]


def test_calls_are_made_by_whoever_is_given_them_in_the_block_alone():
    with called_by(lambda function, rows: iter([function, *rows])):
        assert list(each_call(abs, [(-1,)])) == [abs, (-1,)]
    assert list(each_call(abs, [(-1,)])) == [1]
