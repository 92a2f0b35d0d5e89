"""Fuzz one fuzzing target with coverage: ``python -m fuzz.fuzz_with_coverage TARGET CORPUS [libFuzzer's options]``."""

import sys
import tempfile
from collections import Counter
from pathlib import Path

import atheris

REPOSITORY_ROOT = Path(__file__).parents[1]


def compiled_modules() -> list[str]:
    """List the modules that numba compiles.

    The fuzzer must not instrument modules that numba compiles, because numba cannot compile
    instrumented code.
    """
    paths = [
        path
        for path in (REPOSITORY_ROOT / "firmware_sim").rglob("*.py")
        if "\n@compiled(" in path.read_text()
    ]
    return [".".join(path.relative_to(REPOSITORY_ROOT).with_suffix("").parts) for path in paths]


def main() -> None:
    """Fuzz one fuzzing target with coverage.

    If the fuzzing target crashes, save the input, and end the process with an exit code other than
    0.
    """
    name, corpus, *options = sys.argv[1:]
    with atheris.instrument_imports(
        include=["handctl", "firmware_sim"], exclude=compiled_modules()
    ):
        from fuzz.targets import TARGET_FACTORIES, seed_inputs
    memory_folder = Path("/dev/shm")
    folder = Path(
        tempfile.mkdtemp(prefix="fuzz-", dir=memory_folder if memory_folder.is_dir() else None)
    )
    for i, seed in enumerate(seed_inputs(name, folder)):
        (Path(corpus) / f"seed-{i}").write_bytes(seed)
    target = TARGET_FACTORIES[name](folder)
    count_by_acceptance = Counter[bool]()

    def run_target(data: bytes) -> None:
        count_by_acceptance[target(data)] += 1

    atheris.Setup([sys.argv[0], *options, corpus], run_target)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
