"""The kernels: compiled and interpreted give the same bytes, none compiles in a tick, none is an old one."""

import ast
import inspect
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import handctl
from handctl.compiled import MARKED, SOURCES, kernel, prepare
from handctl.log.read.reader import RunLog
from handctl.replay.rebuild import rebuild
from tests.contracts.random_hands import TICKS, ticked

ROOT = Path(__file__).parents[2]
GOLDEN = ROOT / "logs" / "golden"
LOGS = sorted(path.name for path in GOLDEN.glob("*.mcap"))
PACKAGE = Path(handctl.__file__).parent


def executed(log: Path) -> str:
    """Every hash of the state and every number of a log that is executed again, as one hash."""
    import hashlib

    found = hashlib.blake2b(digest_size=16)
    with RunLog(log) as run, np.errstate(all="ignore"):
        controller = rebuild(run)
        state = controller.initial()
        for one in run.ticks():
            state, out = controller.tick(state, one.tick_in)
            found.update(out.state_hash)
            for numbers in out.telemetry:
                found.update(numbers.tobytes())
    return found.hexdigest()


def interpreted(*words: str) -> subprocess.Popen[str]:
    """Start Python without a compiler."""
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": os.pathsep.join(map(str, sys.path))}
    return subprocess.Popen([sys.executable, *words], env=environment, stdout=subprocess.PIPE, text=True)


@pytest.mark.parametrize("name", LOGS)
def test_interpreted_kernels_give_the_same_bytes(name: str) -> None:
    script = f"from {__name__} import executed, GOLDEN; print(executed(GOLDEN / {name!r}))"
    with interpreted("-c", script) as other:
        mine = executed(GOLDEN / name)
        told, _ = other.communicate(timeout=120)
    assert told.strip() == mine


USUAL = [(1, 0), (2, 0), (5, 1), (11, 1), (24, 0)]
"""Tendons, and seed of the hand."""


@pytest.mark.parametrize(
    "hands", [USUAL, pytest.param([(n, s) for n in range(1, 25) for s in (2, 3)], marks=pytest.mark.nightly)], ids=len
)
def test_interpreted_kernels_do_the_same_to_random_hands(hands: list[tuple[int, int]]) -> None:
    """State, numbers, frames and events of every tick, with frames that are lost, doubled, late and spoilt."""
    with interpreted("-m", "tests.contracts.random_hands", *[f"{n}:{seed}" for n, seed in hands]) as other:
        mine = [ticked(*hand) for hand in hands]
        told, _ = other.communicate(timeout=60.0 * len(hands))
    for hand, one, two in zip(hands, mine, json.loads(told), strict=True):
        apart = [i for i, (a, b) in enumerate(zip(one, two, strict=True)) if a != b]
        assert not apart, f"{hand[0]} tendons, seed {hand[1]}: from tick {apart[0]} on"
        assert len(set(one)) == TICKS, "no tick does nothing"


def test_a_kernel_that_is_prepared_refuses_what_it_was_not_compiled_for() -> None:
    """Otherwise an array of another type would compile for a second in the middle of a tick."""

    @kernel("vector", "real")
    def scaled(values: np.ndarray, by: float) -> np.ndarray:
        return values * by

    prepare()
    np.testing.assert_array_equal(scaled(np.ones(3), 2.0), np.full(3, 2.0))
    np.testing.assert_array_equal(scaled(np.ones(6)[::2], 2.0), np.full(3, 2.0))
    with pytest.raises(TypeError, match="No matching definition"):
        scaled(np.ones(3, dtype=np.float32), 2.0)


PROBE = """
from handctl.compiled import inner, kernel
from handctl.core.block import STATE, tables
from handctl.core.detectors import losses
from handctl.core import block as s


@kernel("block", "layout")
def misses(block, at):
    return losses.halved(tables(block, at), 0)
"""
"""A kernel made of a function of another file, which takes a constant from a third one."""
ASKED = """
from handctl import compiled
from handctl.core import block as s
from handctl.core.probe import misses

layout = s.STATE.layout(dict.fromkeys(s.AXES, 1))
block = layout.initial.copy()
layout.view(block, "lost")[0] = 0b1010101010101
compiled._KERNELS = {name: one for name, one in compiled._KERNELS.items() if "probe" in name}
folder = compiled._FOLDER
before = [] if folder is None else list(folder.rglob("probe.misses-*.nbi"))
compiled.prepare()
assert bool(misses.stats.cache_hits) == (folder is not None), "compiled by another process, and loaded by this one"
print(bool(misses(block, layout.places)), len(before), folder is not None)
"""


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """A copy of the package with a kernel that says whether a node misses every second tick."""
    package = tmp_path / "handctl"
    shutil.copytree(PACKAGE, package, ignore=shutil.ignore_patterns("__pycache__"))
    (package / "core" / "probe.py").write_text(PROBE, encoding="utf-8")
    return package


def ask(package: Path, cache: Path) -> tuple[bool, bool, bool]:
    """Run a copy's kernel; return what it says, whether it was kept from before, and whether anything can be kept."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache), "PYTHONPATH": str(package.parent)}
    command = [sys.executable, "-c", ASKED]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, cwd=package.parent, timeout=120)
    assert done.returncode == 0, done.stderr[-2000:]
    said, hits, kept = done.stdout.split()
    return said == "True", int(hits) > 0, kept == "True"


def test_a_constant_that_is_changed_in_another_file_is_seen(copy: Path, tmp_path: Path) -> None:
    """Numba itself asks only whether the file of the kernel has changed: it would keep the old constant."""
    cache = tmp_path / "cache"
    assert ask(copy, cache) == (True, False, True)
    assert ask(copy, cache) == (True, True, True), "positive control: what has not changed is not compiled again"
    other = copy / "safety" / "faults" / "node.py"
    text = other.read_text(encoding="utf-8")
    assert "HALF_RATE_MISSES = 7\n" in text
    other.write_text(text.replace("HALF_RATE_MISSES = 7\n", "HALF_RATE_MISSES = 8\n"), encoding="utf-8")
    assert ask(copy, cache) == (False, False, True)
    other.write_text(text, encoding="utf-8")
    assert ask(copy, cache) == (True, True, True), "the code of both versions is kept"


@pytest.mark.parametrize("kind", ["missing", "a file", "read-only"])
def test_where_no_cache_can_be_written_each_process_compiles(copy: Path, tmp_path: Path, kind: str) -> None:
    cache = Path("/dev/null/none") if kind == "missing" else tmp_path / "cache"
    if kind != "missing":
        cache.mkdir()
    if kind == "a file":
        (cache / "handctl").write_text("")
    if kind == "read-only":
        cache.chmod(0o555)
    said, hit, kept = ask(copy, cache)
    assert (said, hit) == (True, False)
    assert not kept or (kind == "read-only" and os.geteuid() == 0), "root writes everywhere"


def taken_from(function: Callable[..., object]) -> set[str]:
    """Modules of this package from which a compiled function takes what it names."""
    seen, found = function.__globals__, set[str]()
    used = set(function.__code__.co_names)
    for node in ast.parse(Path(inspect.getfile(function)).read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("handctl"):
            for one in node.names:
                if (one.asname or one.name) in used:
                    value = seen[one.asname or one.name]
                    found.add(value.__name__ if inspect.ismodule(value) else node.module)
    return found | {function.__module__}


def test_kernels_are_made_of_files_that_name_the_folder_of_their_code() -> None:
    """What is outside of these could change without making a new folder."""
    own = [function for function in MARKED if function.__module__.startswith("handctl.")]
    assert len(own) > 100
    inside = tuple(f"handctl.{name.removesuffix('.py')}" for name in SOURCES)
    for function in own:
        outside = {
            name for name in taken_from(function) if not f"{name}.".startswith(tuple(f"{top}." for top in inside))
        }
        assert not outside, function
