"""Which code decided: the version number names a release, this hash also the state between two of them."""

import functools
import hashlib
from pathlib import Path

DECIDING = ("hand", "drives", "safety", "core", "programs", "controller")
"""The rooms that a re-execution runs again."""
UNKNOWN = "?"
"""In a log that does not say."""


@functools.cache
def code_identity() -> str:
    """Twelve hexadecimal digits over the sources of the deciding rooms."""
    package, digest = Path(__file__).parents[1], hashlib.sha256()
    for path in sorted(path for room in DECIDING for path in (package / room).rglob("*.py")):
        digest.update(path.relative_to(package).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()[:12]
