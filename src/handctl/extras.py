"""Optional packages of handctl, and the extras that install these packages.

An extra is a group of optional packages in the sense of pip. ``pip install handctl`` installs the
packages that a program needs to be the client of a controller, to read logs, or to look at a bus.
Every other package belongs to an extra in pyproject.toml.
"""

import sys
from importlib.util import find_spec

from handctl.errors import ConfigError

EXTRA_BY_MODULE = {
    "numba": "controller",
    "llvmlite": "controller",
    "scipy": "controller",
    "filterpy": "controller",
    "control": "controller",
    "matplotlib": "controller",
    "mujoco": "sim",
    "rerun": "view",
    "rerun_cli": "view",
    "pyarrow": "export",
    "optuna": "tune",
    "distributed": "dask",
    "gymnasium": "gym",
}
"""Extra of handctl that installs each optional package, by import name of the package."""


class MissingExtraError(ConfigError):
    """Error for an optional package that is needed but not installed.

    Args:
        feature: command or function that needs the package.
        package: import name of the package.
    """

    def __init__(self, feature: str, package: str) -> None:
        """Build the message of the error. The message contains the command that installs the package."""
        super().__init__(
            f"{feature} needs {package}: pip install 'handctl[{EXTRA_BY_MODULE[package]}]'"
        )


def require_extra(feature: str, *packages: str) -> None:
    """Check that optional packages are installed, but do not import them.

    Args:
        feature: command or function that needs the packages.
        packages: import names of the packages, which are keys of ``EXTRA_BY_MODULE``.

    Raises:
        MissingExtraError: one of the packages is not installed.
    """
    for package in packages:
        if not is_installed(package):
            raise MissingExtraError(feature, package)


def is_installed(package: str) -> bool:
    """Return True if a package is installed. The package is searched, but not imported."""
    if package in sys.modules:
        return sys.modules[package] is not None
    return find_spec(package) is not None


def installed_by_extra() -> dict[str, bool]:
    """Return a bool for each extra of handctl, by the name of the extra.

    The value is True if all packages of the extra are installed.
    """
    return {
        extra: all(
            is_installed(package)
            for package, required_extra in EXTRA_BY_MODULE.items()
            if required_extra == extra
        )
        for extra in EXTRA_BY_MODULE.values()
    }


def missing_extra(feature: str, error: ImportError) -> MissingExtraError | None:
    """Convert the error of a failed import to an error that names the extra to install.

    Args:
        feature: command or function that needs the package.
        error: error of the failed import.

    Returns:
        the error that names the extra, or None if the missing package is not an optional package of
        handctl.
    """
    package = (error.name or "").partition(".")[0]
    return MissingExtraError(feature, package) if package in EXTRA_BY_MODULE else None
