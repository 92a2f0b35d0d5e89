"""Cache of a function's values for immutable objects, by the identity of the object."""

from collections.abc import Callable, Sequence
from typing import Generic, TypeVar

T = TypeVar("T")
MAX_ENTRIES = 256
"""Largest number of cached values."""


class SequenceCache(Generic[T]):
    """Values of a function of each item of a sequence.

    Most items are the same objects from one sequence to the next. Their values are taken over.
    """

    def __init__(self, function: Callable[[T], bytes]) -> None:
        """Create an empty cache.

        Args:
            function: function of an item.
        """
        self._function = function
        self._items: Sequence[T] = ()
        self._values: list[bytes] = []

    def __call__(self, items: Sequence[T]) -> list[bytes]:
        """Return the value of each item."""
        function = self._function
        if len(items) == len(self._items):
            known = zip(items, self._items, self._values, strict=True)
            self._values = [value if item is before else function(item) for item, before, value in known]
        else:
            self._values = [function(item) for item in items]
        self._items = items
        return self._values


class IdentityCache(Generic[T]):
    """Cache of a function's values for immutable objects. An object is found by its identity.

    Equality would not suffice: 1, 1.0 and True are equal, but have different bytes.
    """

    def __init__(self, function: Callable[[T], bytes]) -> None:
        """Create an empty cache.

        Args:
            function: function whose values are cached.
        """
        self._function = function
        self._entries: dict[int, tuple[T, bytes]] = {}

    def __call__(self, key: T) -> bytes:
        """Return the function's value for an object, from the cache if it is there."""
        entry = self._entries.get(id(key))
        if entry is not None and entry[0] is key:
            return entry[1]
        if len(self._entries) >= MAX_ENTRIES:
            self._entries.clear()
        value = self._function(key)
        # The entry holds the object, so that no other object can get its identity.
        self._entries[id(key)] = key, value
        return value
