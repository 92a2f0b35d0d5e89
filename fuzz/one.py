"""One target until its time or its number is over: ``python -m fuzz.one TARGET CORPUS [libFuzzer's options]``."""

import sys
import tempfile
from collections import Counter
from pathlib import Path

import atheris

PLAIN = "--plain"
"""Without looking which branches are taken: inputs are changed from what earlier fuzzing kept, faster but blindly."""


def main() -> None:
    """Fuzz; a crash ends the process with an exit code that is not 0 and keeps its input."""
    name, corpus, *options = sys.argv[1:]
    watched = ["fuzz"] if PLAIN in options else ["handctl", "firmware_sim"]
    options = [option for option in options if option != PLAIN]
    with atheris.instrument_imports(include=watched):
        from fuzz.targets import TARGETS, seeds
    shared = Path("/dev/shm")
    folder = Path(tempfile.mkdtemp(prefix="fuzz-", dir=shared if shared.is_dir() else None))
    for i, seed in enumerate(seeds(name, folder)):
        (Path(corpus) / f"seed-{i}").write_bytes(seed)
    target, verdicts = TARGETS[name](folder), Counter[bool]()

    def counted(data: bytes) -> None:
        verdicts[target(data)] += 1

    atheris.Setup([sys.argv[0], *options, corpus], counted)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
