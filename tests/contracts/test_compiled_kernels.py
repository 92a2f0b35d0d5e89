"""Test the compiled kernels of the controller.

Compiled and interpreted kernels give equal bytes. No kernel is compiled during a tick, and no
outdated machine code is loaded.
"""

import ast
import hashlib
import json
import os
import random
import shutil
import subprocess
import sys
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from numba import njit
from numba.core.errors import TypingError

import handctl
from handctl.compiled import (
    KERNEL_FUNCTIONS,
    KERNEL_SOURCES,
    borrowed_array,
    compile_kernels,
    kernel,
)
from handctl.core.control_law.streamed_motion import begin_segments
from handctl.core.state_block import STATE_SCHEMA, STREAM_RANGE
from handctl.drives.frame import FDF
from handctl.log.read.reader import RunLog
from handctl.replay.controller_rebuild import rebuild_controller
from handctl.runtime.buses.canfd_structs import CANFD_FRAME_BYTES, FrameStructs
from tests.contracts.random_hands import TICKS_PER_HAND, RandomHand, tick_hashes

REPOSITORY = Path(__file__).parents[2]
GOLDEN_LOGS = REPOSITORY / "logs" / "golden"
GOLDEN_LOG_NAMES = sorted(path.name for path in GOLDEN_LOGS.glob("*.mcap"))
PACKAGE_FOLDER = Path(handctl.__file__).parent


def hash_of_execution(log: Path) -> str:
    """Execute the ticks of a log again, and return one hash of the states and telemetry of all ticks."""
    digest = hashlib.blake2b(digest_size=16)
    with RunLog(log) as run, np.errstate(all="ignore"):
        controller = rebuild_controller(run)
        state = controller.initial_state()
        for tick in run.ticks():
            state, out = controller.tick(state, tick.tick_in)
            digest.update(out.state_hash)
            for numbers in out.telemetry:
                digest.update(numbers.tobytes())
    return digest.hexdigest()


def run_without_compiler(*python_arguments: str) -> subprocess.Popen[str]:
    """Start a Python process in which kernels are interpreted instead of compiled."""
    environment = {
        **os.environ,
        "NUMBA_DISABLE_JIT": "1",
        "PYTHONPATH": os.pathsep.join(map(str, sys.path)),
    }
    return subprocess.Popen(
        [sys.executable, *python_arguments], env=environment, stdout=subprocess.PIPE, text=True
    )


DAILY_LOGS = ("jamia-grasp.mcap", "jamia-lost.mcap")
"""Logs for ordinary test runs. ``DAILY_RANDOM_HANDS`` covers faults and other numbers of tendons."""


@pytest.mark.parametrize(
    "name",
    [
        name if name in DAILY_LOGS else pytest.param(name, marks=pytest.mark.nightly)
        for name in GOLDEN_LOG_NAMES
    ],
)
def test_interpreted_kernels_give_the_same_bytes(name: str) -> None:
    script = f"from {__name__} import hash_of_execution, GOLDEN_LOGS; print(hash_of_execution(GOLDEN_LOGS / {name!r}))"
    with run_without_compiler("-c", script) as other_process_result:
        compiled_hash = hash_of_execution(GOLDEN_LOGS / name)
        output, _ = other_process_result.communicate(timeout=120)
    assert output.strip() == compiled_hash


def hash_of_frame_conversions() -> str:
    """Convert random structs of CAN frames to records and back, and return a hash of the results.

    The structs contain frames of all kinds, lengths and flags. The structs also contain frames that
    no CAN controller can send. Some reception times of the frames are negative.
    """
    digest = hashlib.sha256()
    for seed in range(20):
        memory = bytearray(random.Random(seed).randbytes(50 * CANFD_FRAME_BYTES))
        structs = FrameStructs(memory)
        for flag_mask, added_flags in ((0xFF, 0), (0, 0), (0xFF, FDF)):
            frames, has_errors = structs.read(50, 1000 - 100 * seed, 3, flag_mask, added_flags)
            digest.update(frames.records.tobytes() + bytes([has_errors]))
        struct_memory = bytearray(len(memory))
        digest.update(FrameStructs(struct_memory).write(frames).tobytes() + struct_memory)
    return digest.hexdigest()


def test_interpreted_kernels_convert_frames_to_the_same_bytes() -> None:
    script = f"from {__name__} import hash_of_frame_conversions; print(hash_of_frame_conversions())"
    with run_without_compiler("-c", script) as other_process_result:
        output, _ = other_process_result.communicate(timeout=120)
    assert output.strip() == hash_of_frame_conversions()


DAILY_RANDOM_HANDS = [(1, 0), (2, 0), (5, 1), (5, 2), (6, 5), (11, 1), (23, 3), (24, 0)]
"""Number of tendons and seed of each random hand that is tested in ordinary test runs.

In the random hands (5, 2), (6, 5) and (11, 1), drives close position loops. The random hand (6, 5)
has moteus drives. In some ticks of the random hand with 23 tendons and seed 3, values of the state
are NaN.
"""


@pytest.mark.parametrize(
    "seeds_and_lengths",
    [
        DAILY_RANDOM_HANDS,
        pytest.param([(n, s) for n in range(1, 25) for s in (2, 3)], marks=pytest.mark.nightly),
    ],
    ids=len,
)
def test_interpreted_kernels_give_the_same_ticks_of_random_hands(
    seeds_and_lengths: list[tuple[int, int]],
) -> None:
    """Compiled and interpreted kernels give the same state, telemetry, frames and events in every tick.

    Frames that the random hands send can be lost, duplicated, late or corrupt.
    """
    with run_without_compiler(
        "-m", "tests.contracts.random_hands", *[f"{n}:{seed}" for n, seed in seeds_and_lengths]
    ) as other_process_result:
        compiled_hashes = [tick_hashes(*hand) for hand in seeds_and_lengths]
        output, _ = other_process_result.communicate(timeout=60.0 * len(seeds_and_lengths))
    for hand, compiled_hashes_of_hand, interpreted_hashes in zip(
        seeds_and_lengths, compiled_hashes, json.loads(output), strict=True
    ):
        differing_ticks = [
            i
            for i, (a, b) in enumerate(
                zip(compiled_hashes_of_hand, interpreted_hashes, strict=True)
            )
            if a != b
        ]
        assert not differing_ticks, (
            f"{hand[0]} tendons, seed {hand[1]}: from tick {differing_ticks[0]} on"
        )
        assert len(set(compiled_hashes_of_hand)) == TICKS_PER_HAND, "all ticks differ"


def hash_of_motion_segments() -> str:
    """Start 200 random motions to streamed targets, and return one hash of all resulting controller states."""
    digest = hashlib.blake2b(digest_size=16)
    draw = np.random.default_rng(0)
    axes = ("tendon", "joint", "digit", "coordinate", "node", "group", "instance", "run")
    layout = STATE_SCHEMA.layout(dict.fromkeys(axes, 3))
    for i in range(200):
        block = layout.initial.copy()
        rows = layout.table(block, "coordinate")
        rows[...] = draw.normal(size=rows.shape)
        rows[STREAM_RANGE], rows[STREAM_RANGE + 1] = -1.0, 1.0
        aim, held_targets = draw.normal(size=(2, 3))
        duration = draw.uniform(0.002, 0.05)
        target_interval = np.inf if i % 5 == 0 else draw.uniform(0.005, 0.05)
        is_clipped = begin_segments(
            block,
            layout.offsets,
            aim,
            held_targets,
            draw.normal(),
            duration,
            target_interval,
            5.0,
            i % 2,
        )
        digest.update(block.tobytes() + bytes([bool(is_clipped)]))
    return digest.hexdigest()


@pytest.mark.parametrize("tendons", [1, 2, 5, 11, 23])
def test_a_random_hand_of_each_protocol_begins_its_ticks(tendons: int) -> None:
    """The random hands of the test above have drives of five protocols.

    The test above is slow, so most test runs leave it out. In a test run without it, a random hand
    used an attribute of a drive that had been renamed.
    """
    seed = dict(DAILY_RANDOM_HANDS)[tendons]
    with np.errstate(all="ignore"):
        hashes = list(islice(RandomHand(tendons, seed).hash_ticks(), 3))
    assert len(set(hashes)) == 3


def test_interpreted_kernels_begin_the_same_motions() -> None:
    with run_without_compiler(
        "-c", f"from {__name__} import hash_of_motion_segments; print(hash_of_motion_segments())"
    ) as other_process_result:
        compiled_hash = hash_of_motion_segments()
        output, _ = other_process_result.communicate(timeout=120)
    assert output.strip() == compiled_hash


def test_a_prepared_kernel_refuses_other_argument_types() -> None:
    """A compiled kernel raises an exception if it is called with an array type for which it was not compiled.

    Without an exception, a call with a new array type would start a compilation of about 1 s in the
    middle of a tick.
    """

    @kernel("vector", "real")
    def scaled_values(values: np.ndarray, by: float) -> np.ndarray:
        return values * by

    compile_kernels()
    np.testing.assert_array_equal(scaled_values(np.ones(3), 2.0), np.full(3, 2.0))
    np.testing.assert_array_equal(scaled_values(np.ones(6)[::2], 2.0), np.full(3, 2.0))
    with pytest.raises(TypeError, match="No matching definition"):
        scaled_values(np.ones(3, dtype=np.float32), 2.0)


def test_a_program_calls_the_compiled_code_of_ticks_without_a_dispatcher() -> None:
    """In a program of a user, ticks call the compiled code directly, and give the same states as in tests.

    A kernel that other kernels call keeps its dispatcher.
    """
    script = f"""
from {__name__} import hash_of_execution, GOLDEN_LOGS
from handctl.core import tick_stages
from handctl.core.wire import cyclic_frames
from handctl.hand import rigid_body
kernels = (tick_stages.find_faults, cyclic_frames.receive_frames, rigid_body.link_poses)
before = [hasattr(kernel, "py_func") for kernel in kernels]
digest = hash_of_execution(GOLDEN_LOGS / {GOLDEN_LOG_NAMES[0]!r})
kernels = (tick_stages.find_faults, cyclic_frames.receive_frames, rigid_body.link_poses)
print(before, [hasattr(kernel, "py_func") for kernel in kernels], digest)
"""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, sys.path))}
    output = subprocess.check_output(
        [sys.executable, "-c", script], env=environment, text=True, timeout=120
    )
    digest = hash_of_execution(GOLDEN_LOGS / GOLDEN_LOG_NAMES[0])
    assert output.strip() == f"[True, True, True] [False, False, True] {digest}"


def test_a_run_knows_all_kernels_of_its_loop_before_it_compiles() -> None:
    """A kernel that is imported after the compilation would be loaded in the middle of a tick.

    To load a kernel takes some tenths of a second.
    """
    script = """
import handctl.session.run
from handctl import compiled
before = set(compiled._KERNEL_DISPATCHERS)
import handctl.log.tick_packing, handctl.runtime.buses.local_bus, handctl.runtime.buses.socketcan
import handctl.drives.signals, handctl.controller.target_streams, handctl.hand.rigid_body
print(set(compiled._KERNEL_DISPATCHERS) - before)
"""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, sys.path))}
    output = subprocess.check_output(
        [sys.executable, "-c", script], env=environment, text=True, timeout=120
    )
    assert output.strip() == "set()"


def test_only_a_contiguous_array_can_be_borrowed() -> None:
    """A kernel refuses a non-contiguous array.

    In a non-contiguous array, the kernel would also read the memory between the elements.
    """

    @njit
    def third_value(values: np.ndarray) -> float:
        return float(borrowed_array(values, 1, (2,))[1])

    values = np.arange(8.0).reshape(2, 4)
    assert third_value(values) == 2.0
    for strided_array in (values[:, ::2], values.T):
        with pytest.raises(TypingError, match="a kernel can borrow a contiguous array only"):
            third_value(strided_array)


PROBE_MODULE_TEXT = """
from handctl.compiled import kernel, kernel_helper
from handctl.core.state_block import STATE_SCHEMA, state_tables
from handctl.core.detectors import frame_losses
from handctl.core import state_block as s


@kernel("block", "layout")
def misses(block, at):
    return frame_losses.misses_every_second_reply(state_tables(block, at), 0)
"""
"""Source text of a kernel that calls a function in a second file. That function uses a constant in a third file."""
RUN_PROBE_SCRIPT = """
from handctl import compiled
from handctl.core import state_block as s
from handctl.core.probe import misses

layout = s.STATE_SCHEMA.layout(dict.fromkeys(s.STATE_AXES, 1))
block = layout.initial.copy()
layout.view(block, "lost")[0] = 0b1010101010101
compiled._KERNEL_DISPATCHERS = {name: one for name, one in compiled._KERNEL_DISPATCHERS.items() if "probe" in name}
folder = compiled._CACHE_FOLDER
before = [] if folder is None else list(folder.rglob("probe.misses-*.nbi"))
compiled.compile_kernels()
assert (not misses.stats.cache_misses) == (folder is not None), "compiled by another process, and loaded by this one"
print(bool(misses(block, layout.offsets)), len(before), folder is not None)
"""


@pytest.fixture
def package_copy(tmp_path: Path) -> Path:
    """Copy the package handctl, add the module ``PROBE_MODULE_TEXT`` to the copy, and return the path of the copy.

    The kernel in the added module detects a node that is silent in every second tick.
    """
    package = tmp_path / "handctl"
    shutil.copytree(PACKAGE_FOLDER, package, ignore=shutil.ignore_patterns("__pycache__"))
    (package / "core" / "probe.py").write_text(PROBE_MODULE_TEXT, encoding="utf-8")
    return package


def run_copied_kernel(package_folder: Path, cache_folder: Path) -> tuple[bool, bool, bool]:
    """Run the kernel of the module ``core.probe`` in a copy of the package, in another process.

    Returns: The result of the kernel, True if its machine code was loaded from a file, and True if
        its machine code can be stored in a file.
    """
    environment = {
        **os.environ,
        "NUMBA_CACHE_DIR": str(cache_folder),
        "PYTHONPATH": str(package_folder.parent),
    }
    command = [sys.executable, "-c", RUN_PROBE_SCRIPT]
    completed_process = subprocess.run(
        command,
        env=environment,
        capture_output=True,
        text=True,
        cwd=package_folder.parent,
        timeout=120,
    )
    assert completed_process.returncode == 0, completed_process.stderr[-2000:]
    result, hits, stored = completed_process.stdout.split()
    return result == "True", int(hits) > 0, stored == "True"


def test_a_constant_changed_in_another_file_compiles_again(
    package_copy: Path, tmp_path: Path
) -> None:
    """A kernel is compiled again if a constant in another source file changes.

    The cache of numba alone would not notice a changed constant, because this cache checks only the
    source file of the kernel.
    """
    cache_folder = tmp_path / "cache"
    assert run_copied_kernel(package_copy, cache_folder) == (True, False, True)
    assert run_copied_kernel(package_copy, cache_folder) == (True, True, True), (
        "positive control: unchanged code is not compiled again"
    )
    fault_file = package_copy / "safety" / "faults" / "node.py"
    text = fault_file.read_text(encoding="utf-8")
    assert "HALF_RATE_LOSS_COUNT = 7\n" in text
    fault_file.write_text(
        text.replace("HALF_RATE_LOSS_COUNT = 7\n", "HALF_RATE_LOSS_COUNT = 8\n"),
        encoding="utf-8",
    )
    assert run_copied_kernel(package_copy, cache_folder) == (False, False, True)
    fault_file.write_text(text, encoding="utf-8")
    assert run_copied_kernel(package_copy, cache_folder) == (True, True, True), (
        "the code of both versions is kept"
    )


def test_two_installations_of_one_version_store_their_code_apart(
    package_copy: Path, tmp_path: Path
) -> None:
    """Two installations of handctl must not share a cache folder.

    With a shared cache folder, one installation could load machine code that the other installation
    has compiled.
    """
    cache_folder, other_copy = tmp_path / "cache", tmp_path / "other" / package_copy.name
    shutil.copytree(package_copy, other_copy)
    for package in (package_copy, other_copy):
        assert run_copied_kernel(package, cache_folder) == (True, False, True)
    assert len(list((cache_folder / "handctl").glob("kernels-*"))) == 2


@pytest.mark.parametrize("cache_kind", ["missing", "a file", "read-only"])
def test_without_a_writable_cache_each_process_compiles(
    package_copy: Path, tmp_path: Path, cache_kind: str
) -> None:
    cache_folder = Path("/dev/null/none") if cache_kind == "missing" else tmp_path / "cache"
    if cache_kind != "missing":
        cache_folder.mkdir()
    if cache_kind == "a file":
        (cache_folder / "handctl").write_text("")
    if cache_kind == "read-only":
        cache_folder.chmod(0o555)
    result, cache_hits, stored = run_copied_kernel(package_copy, cache_folder)
    assert (result, cache_hits) == (True, False)
    assert not stored or (cache_kind == "read-only" and os.geteuid() == 0), (
        "root can write into read-only folders"
    )


class KernelSources:
    """Modules of handctl whose source text can change the machine code of a kernel.

    The modules define every name on which the kernel depends, directly or through other names.
    """

    def __init__(self) -> None:
        """Create an empty set of modules."""
        self.modules = set[str]()
        self._seen = set[tuple[str, str]]()
        self._trees: dict[str, ast.Module] = {}

    def add_modules_of_name(self, module_name: str, name: str) -> None:
        """Add to ``modules`` the module that defines a name, and the modules of all names in this definition."""
        if (module_name, name) in self._seen:
            return
        self._seen.add((module_name, name))
        self.modules.add(module_name)
        for node in self._syntax_tree(module_name).body:
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("handctl"):
                for alias in node.names:
                    if (alias.asname or alias.name) == name:
                        self._follow_import(str(node.module), alias.name)
            elif name in defined_names(node):
                for used in ast.walk(node):
                    if isinstance(used, ast.Name):
                        self.add_modules_of_name(module_name, used.id)

    def _follow_import(self, module_name: str, name: str) -> None:
        """Add to ``modules`` all modules that define an imported name.

        If the imported name is a module, add the modules of all names that this module defines.
        """
        inner = f"{module_name}.{name}"
        if inner not in sys.modules:
            self.add_modules_of_name(module_name, name)
            return
        self.modules.add(inner)
        for node in self._syntax_tree(inner).body:
            for defined_name in defined_names(node):
                self.add_modules_of_name(inner, defined_name)

    def _syntax_tree(self, module_name: str) -> ast.Module:
        """Return the syntax tree of a module."""
        if module_name not in self._trees:
            self._trees[module_name] = ast.parse(
                Path(str(sys.modules[module_name].__file__)).read_text(encoding="utf-8")
            )
        return self._trees[module_name]


def defined_names(node: ast.stmt) -> set[str]:
    """Return the names that a statement at the top of a module defines."""
    if isinstance(node, ast.FunctionDef | ast.ClassDef):
        return {node.name}
    if isinstance(node, ast.Assign | ast.AnnAssign | ast.AugAssign):
        targets = node.targets if isinstance(node, ast.Assign) else [node.target]
        return {
            target_node.id
            for target in targets
            for target_node in ast.walk(target)
            if isinstance(target_node, ast.Name)
        }
    return set()


def is_source(module_name: str) -> bool:
    """Return True if the name of the cache folder depends on the source text of a module."""
    source_prefixes = tuple(
        "handctl." + name.removesuffix(".py").replace("/", ".") + "." for name in KERNEL_SOURCES
    )
    return f"{module_name}.".startswith(source_prefixes)


def test_the_cache_folder_depends_on_all_sources_of_kernels() -> None:
    """The name of the cache folder depends on the source text of every module that can change a kernel."""
    kernels = [
        function for function in KERNEL_FUNCTIONS if function.__module__.startswith("handctl.")
    ]
    assert len(kernels) > 100
    origins = KernelSources()
    for function in kernels:
        origins.add_modules_of_name(function.__module__, function.__name__)
    assert {
        "handctl.core.block_schema",
        "handctl.safety.faults.tendon",
        "handctl.drives.frame_records",
    } <= origins.modules
    assert [name for name in sorted(origins.modules) if not is_source(name)] == []


def test_every_source_of_kernels_exists() -> None:
    assert [name for name in KERNEL_SOURCES if not (PACKAGE_FOLDER / name).exists()] == []
