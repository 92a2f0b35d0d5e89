"""Identity of the code of the controller: a hash over all of its source files.

A version number identifies only a release. The hash also identifies the code between two releases.
"""

import functools
import hashlib
from pathlib import Path

CONTROL_PACKAGES = ("hand", "drives", "safety", "core", "programs", "controller")
"""Packages of handctl whose code runs when a log is re-executed."""
UNKNOWN_IDENTITY = "?"
"""Text in place of the code identity, for a log that contains no code identity."""


@functools.cache
def code_identity() -> str:
    """Return the first twelve hexadecimal digits of the SHA-256 hash over the source files of the control packages."""
    package = Path(__file__).parents[1]
    digest = hashlib.sha256()
    # The paths are sorted and separated by NUL. With sorted paths, the hash depends only on the
    # names and contents of the files, and not on the order in which the file system lists the
    # files.
    for path in sorted(
        path for name in CONTROL_PACKAGES for path in (package / name).rglob("*.py")
    ):
        digest.update(
            path.relative_to(package).as_posix().encode() + b"\0" + path.read_bytes() + b"\0"
        )
    return digest.hexdigest()[:12]
