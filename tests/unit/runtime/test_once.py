"""Results that are kept by the key of a record."""

from dataclasses import dataclass

from surveysim.runtime.once import keep_last


@dataclass
class Record:
    key: int


def test_the_last_results_are_kept_by_key():
    made = []

    @keep_last(2)
    def double(record):
        made.append(record.key)
        return 2 * record.key

    assert [double(Record(key)) for key in (1, 1, 2, 1, 3, 1)] == [2, 2, 4, 2, 6, 2]
    assert made == [1, 2, 3]  # 2 was used longest ago
    assert double(Record(2)) == 4 and made == [1, 2, 3, 2]


def test_nothing_is_kept_of_a_failure():
    made = []

    @keep_last(1)
    def fail_once(record):
        made.append(record.key)
        return 1 / (len(made) - 1)

    for found in (0, 1):
        try:
            found = fail_once(Record(5))
        except ZeroDivisionError:
            assert made == [5]
    assert found == 1 and made == [5, 5]
