"""Test the hash of the decisions of the controller.

The hash function reuses the stored hashes of values that have not changed since the last tick. A
stored hash of a changed value is never reused.
"""

from dataclasses import replace

import numpy as np
import pytest

from handctl.core.control_law.digit_goal import DigitGoal
from handctl.core.identity_cache import IdentityCache, SequenceCache
from handctl.core.plain_data import join_serialized_fields, serialized_bytes
from handctl.programs.program import ProgramProgress


def hashed_bytes(hashed_value: object) -> bytes:
    return repr(hashed_value).encode()


def test_values_of_same_objects_are_taken_over() -> None:
    hashed_objects = list[object]()

    def bytes_of_recorded_item(item: object) -> bytes:
        hashed_objects.append(item)
        return hashed_bytes(item)

    cache = SequenceCache[object](bytes_of_recorded_item)
    first_list, second_list, third_list = [1], [2], [3]
    assert cache((first_list, second_list)) == [b"[1]", b"[2]"]
    assert cache((first_list, third_list)) == [b"[1]", b"[3]"]
    assert hashed_objects == [first_list, second_list, third_list]


@pytest.mark.parametrize("seed", range(20))
def test_a_sequence_cache_gives_the_same_values_as_its_function(seed: int) -> None:
    """In this test, two controllers in one process use the same cache.

    The controllers compute hashes of sequences with different lengths.
    """
    draw = np.random.default_rng(seed)
    items = [(i, float(i)) for i in range(6)] + [(1, 1), (True, 1.0)]
    cache = SequenceCache[object](IdentityCache[object, bytes](serialized_bytes))
    for _ in range(200):
        sequence = tuple(items[i] for i in draw.integers(0, len(items), draw.integers(0, 5)))
        assert cache(sequence) == [serialized_bytes(item) for item in sequence]


@pytest.mark.parametrize("seed", range(20))
def test_the_bytes_joined_from_fields_are_those_of_the_whole(seed: int) -> None:
    draw = np.random.default_rng(seed)
    digits = int(draw.integers(1, 6))
    progress = ProgramProgress.initial(digits, "zu früh")
    cache = SequenceCache[object](serialized_bytes)
    for _ in range(50):
        goals = (*progress.goals[1:], DigitGoal(rate=float(draw.normal())))
        progress = replace(
            progress,
            since=float(draw.normal()),
            touching=tuple(draw.integers(0, 1000, digits).tolist()),
            goals=goals if draw.random() < 0.3 else progress.goals,
            tare=tuple(draw.normal(size=draw.integers(0, 4)).tolist()),
        )
        assert join_serialized_fields(progress, cache) == serialized_bytes(progress)
