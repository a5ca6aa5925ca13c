from itertools import starmap

from replay_kit.core.tasks import called_by, each_call


def test_calls_are_made_one_by_one_when_their_values_are_asked_for():
    made = []
    values = each_call(lambda a, b: made.append(a) or a + b, ((a, 10) for a in (1, 2, 3)))
    assert made == []
    assert next(values) == 11
    assert made == [1]
    assert list(values) == [12, 13]


def test_calls_are_made_by_whoever_is_given_them_in_the_block_alone():
    def twice(function, rows):
        return (2 * value for value in starmap(function, rows))

    with called_by(twice):
        assert list(each_call(abs, [(-1,), (2,)])) == [2, 4]
    assert list(each_call(abs, [(-1,), (2,)])) == [1, 2]
