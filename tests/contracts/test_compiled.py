"""The controller's kernels: compiled and interpreted give the same bytes, and none compiles in a tick."""

import ast
import inspect
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from handctl.compiled import MARKED, kernel, prepare
from handctl.log.read.reader import RunLog
from handctl.replay.rebuild import rebuild

GOLDEN = Path(__file__).parents[2] / "logs" / "golden"
LOGS = sorted(path.name for path in GOLDEN.glob("*.mcap"))


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


@pytest.mark.parametrize(
    "name", [name if "grasp" in name else pytest.param(name, marks=pytest.mark.nightly) for name in LOGS]
)
def test_interpreted_kernels_give_the_same_bytes(name: str) -> None:
    command = [sys.executable, "-c", f"from {__name__} import executed, GOLDEN; print(executed(GOLDEN / {name!r}))"]
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": os.pathsep.join(map(str, sys.path))}
    told = subprocess.run(command, env=environment, capture_output=True, text=True, check=True, timeout=120)
    assert told.stdout.strip() == executed(GOLDEN / name)


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


def test_where_no_cache_can_be_written_each_process_compiles() -> None:
    script = (
        "from handctl.core.estimation.posture import tip_forces\n"
        "from handctl.compiled import prepare; import numpy as np\n"
        "prepare(); one = np.ones((1, 1))\n"
        "print(tip_forces(one[0], one[0], one[0], one[0], one, one, one, one)[0])"
    )
    environment = {**os.environ, "NUMBA_CACHE_DIR": "/dev/null/none", "PYTHONPATH": os.pathsep.join(map(str, sys.path))}
    command = [sys.executable, "-c", script]
    told = subprocess.run(command, env=environment, capture_output=True, text=True, check=True, timeout=120)
    assert float(told.stdout.strip("[] \n")) == pytest.approx(1.0 / np.cos(1.0), rel=1e-6)


def decided_here(function: Callable[..., object]) -> set[str]:
    """Names that a function's own file assigns from literals and from names of this kind."""
    found: set[str] = set()
    for node in ast.parse(Path(inspect.getfile(function)).read_text()).body:
        if isinstance(node, ast.Assign):
            used = {one.id for one in ast.walk(node.value) if isinstance(one, ast.Name)}
            if used <= found | {"range", "math"}:
                found |= {one.id for target in node.targets for one in ast.walk(target) if isinstance(one, ast.Name)}
    return found


def test_no_kernel_reads_a_constant_that_another_file_decides() -> None:
    """The cache would keep the value of before."""
    own = [function for function in MARKED if function.__module__.startswith("handctl.")]
    assert len(own) > 10
    for function in own:
        seen = function.__globals__
        numbers = {name for name in function.__code__.co_names if isinstance(seen.get(name), int | float)}
        assert numbers <= decided_here(function), function
