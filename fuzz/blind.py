"""One target without a look at its branches: ``python -m fuzz.blind TARGET CORPUS FOUND SECONDS RUNS LONGEST``.

What coverage-guided fuzzing kept is changed at random, a few times faster than with the guide: for the large count.
"""

import random
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from fuzz.targets import TARGETS, seeds

NEWS_S = 30.0
AT_ONCE = 256
"""Inputs between two looks at the clock."""


def changed(chance: random.Random, kept: list[bytes], longest: int) -> Iterator[bytes]:
    """Inputs without end: a kept one with some bytes changed, taken out, put in, or with the end of another one."""
    pick, bits = chance.choice, chance.getrandbits
    while True:
        kind = bits(4)
        if kind == 0:
            yield chance.randbytes(bits(16) % longest)
            continue
        data = bytearray(pick(kept))
        for _ in range(1 + (kind & 3)):
            at = bits(16) % (len(data) + 1)
            way = bits(3)
            if way < 4 and at < len(data):
                data[at] = bits(8)
            elif way == 4 and at < len(data):
                data[at] ^= 1 << bits(3)
            elif way == 5:
                del data[at : at + 1 + bits(2)]
            elif way == 6:
                data[at:at] = chance.randbytes(1 + bits(3))
            else:
                data[at:] = pick(kept)[at:]
        yield bytes(data[:longest])


def fuzz(
    target: Callable[[bytes], bool], inputs: Iterator[bytes], found: Path, seconds: float, runs: int
) -> tuple[int, int]:
    """Feed a target; what gets out of it ends this process, with its input kept.

    Returns:
        how many inputs there were, and how many of them were taken.
    """
    begin = told = time.monotonic()
    number, taken, data = 0, 0, b""
    try:
        while runs < 0 or number < runs:
            for data, _ in zip(inputs, range(AT_ONCE), strict=False):
                taken += target(data)
            number += AT_ONCE
            now = time.monotonic()
            if 0 < seconds <= now - begin:
                break
            if now - told > NEWS_S:
                told = now
                print(f"{number} runs, {number / (now - begin):.0f}/s", file=sys.stderr, flush=True)
    except BaseException:
        (found / "blind").write_bytes(data)
        raise
    return number, taken


def main() -> None:
    """Fuzz as long or as often as it was asked for."""
    name, corpus, found, seconds, runs, longest = sys.argv[1:]
    shared = Path("/dev/shm")
    folder = Path(tempfile.mkdtemp(prefix="fuzz-", dir=shared if shared.is_dir() else None))
    kept = [path.read_bytes()[: int(longest)] for path in sorted(Path(corpus).iterdir())]
    kept += [seed[: int(longest)] for seed in seeds(name, folder)] or [bytes(8)]
    begin = time.monotonic()
    inputs = changed(random.Random(time.time_ns()), kept, int(longest))
    number, taken = fuzz(TARGETS[name](folder), inputs, Path(found), float(seconds), int(runs))
    took = round(time.monotonic() - begin)
    print(f"Done {number} runs in {took} second(s), {taken} taken, from {len(kept)} kept", file=sys.stderr)


if __name__ == "__main__":
    main()
