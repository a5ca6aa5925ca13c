from itertools import repeat

from replay_kit.core.tasks import each_of, made_by


def test_calls_are_made_one_by_one_when_their_values_are_asked_for() -> None:
    made = []
    values = each_of(lambda a, b: made.append(a) or a + b, (1, 2, 3), repeat(10))
    assert made == []
    assert next(values) == 11
    assert made == [1]
    assert list(values) == [12, 13]


def test_calls_are_made_by_whoever_is_given_them_in_the_block_alone() -> None:
    def twice(function, *columns):
        return (2 * value for value in map(function, *columns))

    with made_by(twice):
        assert list(each_of(abs, (-1, 2))) == [2, 4]
    assert list(each_of(abs, (-1, 2))) == [1, 2]
