"""Fuzz one fuzzing target without measuring coverage.

    python -m fuzz.fuzz_without_coverage TARGET CORPUS FOUND SECONDS RUNS LONGEST

The program randomly changes inputs of a corpus that coverage-guided fuzzing has collected before.
Fuzzing without coverage (blind fuzzing) is a few times faster than coverage-guided fuzzing, and
tests more inputs in the same time.
"""

import random
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from fuzz.targets import TARGET_FACTORIES, seed_inputs

REPORT_PERIOD_S = 30.0
INPUTS_PER_CLOCK_READ = 256
"""Number of inputs between two readings of the clock."""


def mutated_inputs(
    random_source: random.Random, corpus: list[bytes], max_bytes: int
) -> Iterator[bytes]:
    """Yield randomly changed inputs of the corpus, without end.

    A change replaces, removes or inserts bytes, or copies the last bytes of another input. One in
    sixteen inputs is entirely random.
    """
    random_choice = random_source.choice
    bits = random_source.getrandbits
    while True:
        kind = bits(4)
        if kind == 0:
            yield random_source.randbytes(bits(16) % max_bytes)
            continue
        data = bytearray(random_choice(corpus))
        for _ in range(1 + (kind & 3)):
            position = bits(16) % (len(data) + 1)
            operation = bits(3)
            if operation < 4 and position < len(data):
                data[position] = bits(8)
            elif operation == 4 and position < len(data):
                data[position] ^= 1 << bits(3)
            elif operation == 5:
                del data[position : position + 1 + bits(2)]
            elif operation == 6:
                data[position:position] = random_source.randbytes(1 + bits(3))
            else:
                data[position:] = random_choice(corpus)[position:]
        yield bytes(data[:max_bytes])


def feed_inputs(
    target: Callable[[bytes], bool],
    inputs: Iterator[bytes],
    crash_folder: Path,
    duration_s: float,
    run_count: int,
) -> tuple[int, int]:
    """Feed inputs to a fuzzing target.

    If the fuzzing target raises an exception, save the input and end this process.

    Returns:
        The number of inputs, and the number of inputs that the parser accepted.
    """
    start_s = reported_time_s = time.monotonic()
    executed_input_count = 0
    accepted_count = 0
    data = b""
    try:
        while run_count < 0 or executed_input_count < run_count:
            for data, _ in zip(inputs, range(INPUTS_PER_CLOCK_READ), strict=False):
                accepted_count += target(data)
            executed_input_count += INPUTS_PER_CLOCK_READ
            now_s = time.monotonic()
            if 0 < duration_s <= now_s - start_s:
                break
            if now_s - reported_time_s > REPORT_PERIOD_S:
                reported_time_s = now_s
                print(
                    f"{executed_input_count} runs, {executed_input_count / (now_s - start_s):.0f}/s",
                    file=sys.stderr,
                    flush=True,
                )
    except BaseException:
        (crash_folder / "blind").write_bytes(data)
        raise
    return executed_input_count, accepted_count


def main() -> None:
    """Fuzz one fuzzing target for the requested time or number of inputs."""
    name, corpus_folder, crash_folder, duration_s, run_count, max_input_bytes = sys.argv[1:]
    memory_folder = Path("/dev/shm")
    folder = Path(
        tempfile.mkdtemp(prefix="fuzz-", dir=memory_folder if memory_folder.is_dir() else None)
    )
    corpus_inputs = [
        path.read_bytes()[: int(max_input_bytes)] for path in sorted(Path(corpus_folder).iterdir())
    ]
    corpus_inputs += [seed[: int(max_input_bytes)] for seed in seed_inputs(name, folder)] or [
        bytes(8)
    ]
    start_s = time.monotonic()
    inputs = mutated_inputs(random.Random(time.time_ns()), corpus_inputs, int(max_input_bytes))
    executed_input_count, accepted_count = feed_inputs(
        TARGET_FACTORIES[name](folder),
        inputs,
        Path(crash_folder),
        float(duration_s),
        int(run_count),
    )
    run_time_s = round(time.monotonic() - start_s)
    count = len(corpus_inputs)
    print(
        f"Done {executed_input_count} runs in {run_time_s} second(s), {accepted_count} inputs accepted, "
        f"corpus of {count} inputs",
        file=sys.stderr,
    )


if __name__ == "__main__":
    main()
