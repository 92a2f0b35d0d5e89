"""No module imports itself by way of others, wherever in the module the import stands."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
Graph = dict[str, set[str]]


def modules() -> dict[str, Path]:
    """Return every module of the two packages with its file; packages themselves hold no code."""
    found = {}
    for package in (ROOT / "src" / "handctl", ROOT / "firmware_sim"):
        for path in package.rglob("*.py"):
            parts = (package.name, *path.relative_to(package).with_suffix("").parts)
            found[".".join(parts).removesuffix(".__init__")] = path
    return found


def imports(source: str, known: set[str]) -> set[str]:
    """Return the known modules that a source imports, in functions and for types too."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.Import(names=names):
                found |= {one.name for one in names}
            case ast.ImportFrom(module=str(module), names=names):
                whole = {f"{module}.{one.name}" for one in names} & known
                found |= whole or {module}
    return found & known


def circles(graph: Graph) -> list[set[str]]:
    """Return the groups of modules that reach each other."""
    reach = {name: set(targets) for name, targets in graph.items()}
    for middle in graph:
        for targets in reach.values():
            if middle in targets:
                targets |= reach[middle]
    groups = {frozenset(other for other in reach[name] if name in reach[other]) for name in graph}
    return sorted((set(group) for group in groups if group), key=sorted)


def test_the_search_finds_circles_of_any_length() -> None:
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}) == [{"a", "b", "c"}]
    assert circles({"a": {"b"}, "b": {"c"}, "c": set()}) == []
    known = {"handctl.a", "handctl.b", "handctl.b.c"}
    assert imports("from handctl.b import c", known) == {"handctl.b.c"}
    assert imports("def f():\n    import handctl.a", known) == {"handctl.a"}


@pytest.mark.parametrize("package", ["handctl", "firmware_sim"])
def test_no_module_imports_itself_by_way_of_others(package: str) -> None:
    files = {name: path for name, path in modules().items() if name.split(".")[0] == package}
    graph = {name: imports(path.read_text(encoding="utf-8"), set(files)) - {name} for name, path in files.items()}
    assert circles(graph) == []
