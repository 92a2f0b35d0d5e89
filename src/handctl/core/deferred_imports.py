"""Fast import of the packages scipy, filterpy and control.

Modules of scipy, filterpy and control that handctl does not use are not imported. The import of
``scipy.stats``, ``scipy.ndimage`` and the plots of control takes longer than the import of all
other modules of a run. Half of the import time of ``scipy.linalg`` is spent on modules for Fortran
compilers and for tests. Each module in ``DEFERRED_MODULES`` is replaced by a stand-in object. The
stand-in imports the real module when one of the module's functions is used for the first time.
"""

import importlib
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.machinery import PathFinder
from types import ModuleType
from typing import Any

DEFERRED_MODULES = (
    "scipy.stats", "scipy.ndimage", "scipy.sparse", "scipy.sparse.linalg", "numpy.f2py", "numpy.testing",
)  # fmt: skip
"""Modules that filterpy or scipy import, for functions that handctl does not call."""


class _DeferredAttribute:
    """Stand-in for a function or a probability distribution of a module that is not imported yet.

    The first use of the stand-in imports the module.
    """

    def __init__(self, module_name: str, name: str) -> None:
        self._module = module_name
        self._name = name

    def __getattr__(self, method: str) -> Callable[..., Any]:
        return lambda *positional_arguments, **keyword_arguments: self._apply_to_real_object(
            lambda real: getattr(real, method)(*positional_arguments, **keyword_arguments)
        )

    def __call__(self, *positional_arguments: Any, **keyword_arguments: Any) -> Any:
        """Import the module, and call the real function."""
        return self._apply_to_real_object(
            lambda real: real(*positional_arguments, **keyword_arguments)
        )

    def _apply_to_real_object(self, operation: Callable[[Any], Any]) -> Any:
        """Import the module, and apply ``operation`` to the function or distribution that the stand-in replaces.

        During the import of filterpy, one function of a stand-in is called as a trial. The result
        of the trial call is None.
        """
        module: Any = importlib.import_module(self._module)
        imported_object = getattr(module, self._name)
        return (
            None if isinstance(imported_object, _DeferredAttribute) else operation(imported_object)
        )


class _StandInModule(ModuleType):
    """Stand-in for a module. The first use of a function imports the real module."""

    def __getattr__(self, name: str) -> _DeferredAttribute:
        # the import system looks for ``__path__`` and similar names in every module
        if name.startswith("__"):
            raise AttributeError(name)
        return _DeferredAttribute(self.__name__, name)


@contextmanager
def deferred_imports() -> Iterator[None]:
    """Replace the modules in ``DEFERRED_MODULES`` by stand-ins, for the duration of a ``with`` block.

    Each stand-in also becomes an attribute of the package that contains the replaced module.
    """
    packages_and_modules = []
    for name in DEFERRED_MODULES:
        if name in sys.modules:
            continue
        package_name, _, module_name = name.rpartition(".")
        # The package of ``scipy.sparse.linalg`` is the stand-in for ``scipy.sparse``.
        package = importlib.import_module(package_name)
        sys.modules[name] = stand_in_module = _StandInModule(name)
        setattr(package, module_name, stand_in_module)
        packages_and_modules.append((package, module_name))
    try:
        yield
    finally:
        for package, module_name in packages_and_modules:
            del sys.modules[f"{package.__name__}.{module_name}"]
            delattr(package, module_name)


class DeferredModule:
    """Module that is imported when one of its attributes is used for the first time.

    Programs that never use the module can run without its package. If the package is not installed,
    the first use of an attribute raises ModuleNotFoundError.
    """

    def __init__(
        self, name: str, load: Callable[[str], ModuleType] = importlib.import_module
    ) -> None:
        """Store the name of the module. The module is not imported here.

        Args:
            name: full name of the module, for example ``scipy.linalg``.
            load: function that imports the module.
        """
        self._name = name
        self._load = load

    def __getattr__(self, attribute: str) -> Any:
        """Import the module, and return one of its attributes. The attribute is stored in the ``DeferredModule``."""
        with deferred_imports():
            module = self._load(self._name)
        value = getattr(module, attribute)
        setattr(self, attribute, value)
        return value


def import_without_package_init(name: str) -> ModuleType:
    """Import a module of a package, but do not execute the file ``__init__`` of the package.

    A later import of the whole package works as usual. The import ignores a file with the name of
    the package, such as ``control.py``, in the folder of the user's program.

    Args:
        name: full name of the module, for example ``control.mateqn``.

    Raises:
        ModuleNotFoundError: the package is not installed.
    """
    package = name.partition(".")[0]
    loaded_module = sys.modules.get(package)
    if hasattr(loaded_module, "__path__"):
        return importlib.import_module(name)
    module_specs = (PathFinder.find_spec(package, [folder]) for folder in sys.path)
    package_folders = [
        spec.submodule_search_locations
        for spec in module_specs
        if spec and spec.submodule_search_locations
    ]
    if not package_folders:
        raise ModuleNotFoundError(f"No module named {package!r}", name=package)
    package_stub = ModuleType(package)
    package_stub.__path__ = list(package_folders[0])
    sys.modules[package] = package_stub
    try:
        return importlib.import_module(name)
    finally:
        for module_name in [
            module_name
            for module_name in sys.modules
            if module_name == package or module_name.startswith(f"{package}.")
        ]:
            del sys.modules[module_name]
        if loaded_module is not None:
            sys.modules[package] = loaded_module
