"""Import of filterpy and control without ``scipy.stats``, which neither needs for what handctl calls.

The import of ``scipy.stats`` takes as long as all others of a run. It is put off until somebody uses a function of it.
"""

import importlib
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any

STATS = "scipy.stats"


class _Deferred:
    """A function or distribution of ``scipy.stats``, imported at its first use."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, method: str) -> Callable[..., Any]:
        return lambda *given, **named: self._use(lambda real: getattr(real, method)(*given, **named))

    def __call__(self, *given: Any, **named: Any) -> Any:
        """Call the real function."""
        return self._use(lambda real: real(*given, **named))

    def _use(self, use: Callable[[Any], Any]) -> Any:
        """Use the real object; compute nothing during the import of filterpy, which tries one call."""
        stats: Any = importlib.import_module(STATS)
        real = getattr(stats, self._name)
        return None if isinstance(real, _Deferred) else use(real)


class _StandIn(ModuleType):
    """A module of which every public name is deferred."""

    def __getattr__(self, name: str) -> _Deferred:
        if name.startswith("__"):  # the import system asks for __path__ and the like
            raise AttributeError(name)
        return _Deferred(name)


@contextmanager
def deferred_stats() -> Iterator[None]:
    """Stand in for ``scipy.stats`` during an import."""
    if STATS in sys.modules:
        yield
        return
    sys.modules[STATS] = _StandIn(STATS)
    try:
        yield
    finally:
        del sys.modules[STATS]
