"""What follows from an immutable object, kept for as long as the object may come again."""

from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar("T")
MOST = 256


class Kept(Generic[T]):
    """A function of one immutable object that is computed once for each object, told apart by identity.

    Equality would not do: 1, 1.0 and True are equal, and are not written alike.
    """

    def __init__(self, function: Callable[[T], bytes]) -> None:
        self._function = function
        self._known: dict[int, tuple[T, bytes]] = {}

    def __call__(self, thing: T) -> bytes:
        """Value of the function."""
        found = self._known.get(id(thing))
        if found is not None and found[0] is thing:
            return found[1]
        if len(self._known) >= MOST:
            self._known.clear()
        value = self._function(thing)
        self._known[id(thing)] = thing, value  # holding the object keeps its identity its own
        return value
