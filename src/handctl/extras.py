"""Optional packages: the verbs that need them, and the extras of handctl that install them.

``pip install handctl`` installs what a controller on a real bus needs. All other packages belong to
an extra in pyproject.toml.
"""

import sys
from importlib.util import find_spec

from handctl.errors import ConfigError

EXTRAS = {
    "mujoco": "sim",
    "rerun": "view",
    "rerun_cli": "view",
    "pyarrow": "export",
    "optuna": "tune",
    "distributed": "dask",
    "gymnasium": "gym",
}
"""Import name of each optional package, and the extra that installs it."""


class MissingExtraError(ConfigError):
    """An optional package that is not installed.

    Args:
        user: verb or function that needs the package.
        package: import name.
    """

    def __init__(self, user: str, package: str) -> None:
        super().__init__(f"{user} needs {package}: pip install 'handctl[{EXTRAS[package]}]'")


def require_extra(user: str, *packages: str) -> None:
    """Check that optional packages are installed, without importing them.

    Args:
        user: verb or function that needs the packages.
        packages: import names, keys of ``EXTRAS``.

    Raises:
        MissingExtraError: one is not installed.
    """
    for package in packages:
        if not is_installed(package):
            raise MissingExtraError(user, package)


def is_installed(package: str) -> bool:
    """Return True if a package can be imported, without importing it."""
    if package in sys.modules:
        return sys.modules[package] is not None
    return find_spec(package) is not None


def extras_installed() -> dict[str, bool]:
    """Return for each extra True if all its packages are installed."""
    return {
        extra: all(is_installed(package) for package, other in EXTRAS.items() if other == extra)
        for extra in EXTRAS.values()
    }


def missing_extra(user: str, error: ImportError) -> MissingExtraError | None:
    """Translate a failed import.

    Args:
        user: verb or function that needs the package.
        error: the failed import.

    Returns:
        The error that names the extra, or None if the package is not an optional one.
    """
    package = (error.name or "").partition(".")[0]
    return MissingExtraError(user, package) if package in EXTRAS else None
