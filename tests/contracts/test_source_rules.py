"""Test rules of the source code that import-linter cannot check."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]
LOOP_MODULE = Path("src/handctl/runtime/loop.py")
LOCK_FILES = (
    "requirements.lock",
    "requirements-demo.lock",
    "requirements-dev.lock",
    "requirements-extra.lock",
)
BROAD_EXCEPTIONS = {"Exception", "BaseException"}
OWN_PACKAGES = {"handctl", "firmware_sim", "tests", "fuzz", "benchmarks"}


def source_files(*folder_names: str) -> list[Path]:
    paths = sorted(path for folder in folder_names for path in (REPOSITORY / folder).rglob("*.py"))
    assert paths, folder_names
    return paths


def lines_of_broad_handlers(source_text: str) -> Iterator[int]:
    """Yield the line number of each ``except`` clause and each call of ``suppress`` that catches all exceptions."""
    for node in ast.walk(ast.parse(source_text)):
        match node:
            case ast.ExceptHandler(type=None):
                yield node.lineno
            case ast.ExceptHandler(type=caught):
                if BROAD_EXCEPTIONS & names_in_expression(caught):
                    yield node.lineno
            case ast.Call(
                func=ast.Name(id="suppress") | ast.Attribute(attr="suppress"), args=caught
            ):
                if BROAD_EXCEPTIONS & set().union(*map(names_in_expression, caught)):
                    yield node.lineno


def names_in_expression(node: ast.AST | None) -> set[str]:
    inner_nodes = list(ast.walk(node)) if node else []
    return {inner_node.id for inner_node in inner_nodes if isinstance(inner_node, ast.Name)} | {
        inner_node.attr for inner_node in inner_nodes if isinstance(inner_node, ast.Attribute)
    }


@pytest.mark.parametrize(
    ("handler_text", "expected_lines"),
    [
        ("except:", [3]),
        ("except Exception:", [3]),
        ("except (ValueError, BaseException) as error:", [3]),
        ("except builtins.Exception:", [3]),
        ("except (ValueError, OSError):", []),
    ],
)
def test_the_search_finds_broad_handlers(handler_text: str, expected_lines: list[int]) -> None:
    assert (
        list(lines_of_broad_handlers(f"try:\n    pass\n{handler_text}\n    pass\n"))
        == expected_lines
    )


def test_only_the_loop_catches_all_exceptions_and_once() -> None:
    for path in source_files("src", "firmware_sim"):
        lines = list(lines_of_broad_handlers(path.read_text(encoding="utf-8")))
        allowed = 1 if path.relative_to(REPOSITORY) == LOOP_MODULE else 0
        assert len(lines) <= allowed, (
            f"{path.relative_to(REPOSITORY)} catches everything in lines {lines}"
        )


def test_only_one_module_builds_the_simulated_hand() -> None:
    """Only the module ``session.lockstep_simulation`` builds a simulated hand in lockstep.

    The module ``clocks.lockstep`` defines the parts from which a simulated hand in lockstep is
    built.
    """
    building_modules = {
        str(path.relative_to(REPOSITORY))
        for path in source_files("src", "benchmarks", "fuzz")
        if re.search(r"\b(load_simulator|LockstepClock)\(", path.read_text(encoding="utf-8"))
    }
    assert building_modules == {
        "src/handctl/runtime/clocks/lockstep.py",
        "src/handctl/session/lockstep_simulation.py",
    }


def test_no_folder_has_more_than_fourteen_modules() -> None:
    for folder in {path.parent for path in source_files("src", "firmware_sim")}:
        modules = [path for path in folder.glob("*.py") if path.stem != "__init__"]
        assert len(modules) <= 14, f"{folder.relative_to(REPOSITORY)} has {len(modules)} modules"


def test_no_miscellaneous_modules_and_no_todo_marks() -> None:
    for path in source_files("src", "firmware_sim"):
        assert path.stem not in {"utils", "util", "common", "helpers", "misc"}, path
        text = path.read_text(encoding="utf-8")
        assert not {"TODO", "FIXME", "XXX"} & set(text.replace(":", " ").split()), path


def test_the_locks_name_no_index_and_hash_every_package() -> None:
    for name in LOCK_FILES:
        text = (REPOSITORY / name).read_text(encoding="utf-8")
        assert "://" not in text, name
        assert "--index" not in text, name
        assert "--find-links" not in text, name
        pins = [
            block
            for block in text.split("\n")
            if "==" in block and not block.lstrip().startswith("#")
        ]
        assert pins, name
        blocks = re.findall(r"^[a-z0-9][^\n]*==(?:[^\n]*\\\n)*[^\n]*", text, re.MULTILINE)
        assert len(blocks) == len(pins), name
        assert all("--hash=sha256:" in block for block in blocks), (
            f"{name}: a package without hashes"
        )


def names_of_module(module_name: str) -> set[str]:
    """Return every name that a module or a package defines or imports."""
    candidate_paths = [
        top / module_name.replace(".", "/") for top in (REPOSITORY / "src", REPOSITORY)
    ]
    module_path = next(
        module_path
        for module_path in candidate_paths
        if module_path.is_dir() or module_path.with_suffix(".py").exists()
    )
    if module_path.is_dir():
        known_names, file = (
            {path.stem for path in module_path.iterdir()},
            module_path / "__init__.py",
        )
    else:
        known_names, file = set(), module_path.with_suffix(".py")
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8") if file.exists() else "")):
        match node:
            case (
                ast.FunctionDef(name=name)
                | ast.ClassDef(name=name)
                | ast.Name(id=name, ctx=ast.Store())
            ):
                known_names.add(name)
            case ast.alias(name=name, asname=new_name):
                known_names.add(new_name or name)
    return known_names


@pytest.mark.parametrize(
    "path", source_files("fuzz", "benchmarks"), ids=lambda path: f"{path.parent.name}/{path.name}"
)
def test_names_imported_by_fuzz_and_benchmarks_exist(path: Path) -> None:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if (
            isinstance(node, ast.ImportFrom)
            and node.module
            and node.module.split(".")[0] in OWN_PACKAGES
        ):
            assert {alias.name for alias in node.names} <= names_of_module(node.module), node.module
