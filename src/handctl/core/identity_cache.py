"""Caches for the results of a function.

A cache finds the result for an immutable object by the identity of the object.
"""

from collections.abc import Callable, Sequence
from itertools import compress
from operator import is_not
from typing import Generic, TypeVar

T = TypeVar("T")
R = TypeVar("R")
MAX_CACHED_VALUES = 256
"""Largest number of cached values."""


class SequenceCache(Generic[T]):
    """Cache of a function's results for the items of a sequence.

    The cache compares each item with the item at the same index of the last sequence. If both items
    are the same object, the cache returns the earlier result. The cache saves time if most objects
    stay the same from one sequence to the next.
    """

    def __init__(self, serialize: Callable[[T], bytes]) -> None:
        """Create an empty cache.

        Args:
            serialize: function that computes the result for an item.
        """
        self._function = serialize
        self._items: Sequence[T] = ()
        self._values: list[bytes] = []

    def __call__(self, items: Sequence[T]) -> list[bytes]:
        """Return the results of the function for all items of a sequence."""
        if items is self._items:
            return self._values
        function = self._function
        if len(items) == len(self._items):
            values = self._values.copy()
            # The loop only executes for the new items, because ``compress`` leaves out the others.
            for index in compress(range(len(items)), map(is_not, items, self._items)):
                values[index] = function(items[index])
        else:
            values = [function(item) for item in items]
        self._items = items
        self._values = values
        return values


class IdentityCache(Generic[T, R]):
    """Cache of a function's results for immutable objects.

    The cache finds the stored result of an object by the identity of the object. Equality would not
    be sufficient, because 1, 1.0 and True are equal, but the function returns different bytes for
    them.
    """

    def __init__(self, function: Callable[[T], R]) -> None:
        """Create an empty cache.

        Args:
            function: function whose results are cached.
        """
        self._function = function
        self._entries: dict[int, tuple[T, R]] = {}

    def __call__(self, key: T) -> R:
        """Return the result of the function for an object.

        The result is computed only if the cache does not contain the object.
        """
        entry = self._entries.get(id(key))
        if entry is not None and entry[0] is key:
            return entry[1]
        if len(self._entries) >= MAX_CACHED_VALUES:
            self._entries.clear()
        value = self._function(key)
        # The cache entry refers to the object, so that no other object can get the same identity.
        self._entries[id(key)] = key, value
        return value
