"""Cache of values derived from immutable objects, by identity."""

from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar("T")
MAX_ENTRIES = 256
"""Largest number of cached values."""


class IdentityCache(Generic[T]):
    """Cache of a function of immutable objects. Each object is looked up by its identity.

    Equality would not suffice: 1, 1.0 and True are equal, but serialized differently.
    """

    def __init__(self, function: Callable[[T], bytes]) -> None:
        """Create an empty cache.

        Args:
            function: of the object.
        """
        self._function = function
        self._known: dict[int, tuple[T, bytes]] = {}

    def __call__(self, thing: T) -> bytes:
        """Return the function's value, from the cache if possible."""
        found = self._known.get(id(thing))
        if found is not None and found[0] is thing:
            return found[1]
        if len(self._known) >= MAX_ENTRIES:
            self._known.clear()
        value = self._function(thing)
        self._known[id(thing)] = thing, value  # holding the object keeps its identity its own
        return value
