"""Test that no module imports itself through other modules, neither at its top nor within a function."""

import ast
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]
ImportGraph = dict[str, set[str]]


def module_files() -> dict[str, Path]:
    """Return the name and the file of every module of handctl and firmware_sim.

    The file of a package is its `__init__.py`, which contains no code.
    """
    files = {}
    for package in (REPOSITORY / "src" / "handctl", REPOSITORY / "firmware_sim"):
        for path in package.rglob("*.py"):
            module_path = (package.name, *path.relative_to(package).with_suffix("").parts)
            files[".".join(module_path).removesuffix(".__init__")] = path
    return files


def imported_modules(source_text: str, known_modules: set[str]) -> set[str]:
    """Return the modules that a source text imports, including imports in functions and for type hints."""
    imported: set[str] = set()
    for node in ast.walk(ast.parse(source_text)):
        match node:
            case ast.Import(names=names):
                imported |= {alias.name for alias in names}
            case ast.ImportFrom(module=str(module), names=names):
                imported_submodules = {f"{module}.{alias.name}" for alias in names} & known_modules
                imported |= imported_submodules or {module}
    return imported & known_modules


def import_cycles(import_graph: ImportGraph) -> list[set[str]]:
    """Return the groups of modules that import each other, directly or through other modules."""
    reachable_modules = {name: set(targets) for name, targets in import_graph.items()}
    for middle_module in import_graph:
        for targets in reachable_modules.values():
            if middle_module in targets:
                targets |= reachable_modules[middle_module]
    groups = {
        frozenset(
            other_name
            for other_name in reachable_modules[name]
            if name in reachable_modules[other_name]
        )
        for name in import_graph
    }
    return sorted((set(group) for group in groups if group), key=sorted)


def test_the_search_detects_circles_of_any_length() -> None:
    assert import_cycles({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}) == [{"a", "b", "c"}]
    assert import_cycles({"a": {"b"}, "b": {"c"}, "c": set()}) == []
    known_modules = {"handctl.a", "handctl.b", "handctl.b.c"}
    assert imported_modules("from handctl.b import c", known_modules) == {"handctl.b.c"}
    assert imported_modules("def f():\n    import handctl.a", known_modules) == {"handctl.a"}


@pytest.mark.parametrize("package_name", ["handctl", "firmware_sim"])
def test_no_import_circles(package_name: str) -> None:
    files = {
        name: path for name, path in module_files().items() if name.split(".")[0] == package_name
    }
    import_graph = {
        name: imported_modules(path.read_text(encoding="utf-8"), set(files)) - {name}
        for name, path in files.items()
    }
    assert import_cycles(import_graph) == []
