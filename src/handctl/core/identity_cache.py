"""Cache of a function's values for immutable objects, by the identity of the object."""

from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar("T")
MAX_ENTRIES = 256
"""Largest number of cached values."""


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
