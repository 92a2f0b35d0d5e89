"""What mutmut left alive: each module's score, and survivors without a reason in docs/evidence/mutation.md."""

import json
import sys
from collections import Counter
from pathlib import Path

REASONS = Path("docs/evidence/mutation.md")
SURVIVED, UNTESTED = 0, 33
"""Exit codes in mutmut's records; 33: no test that was chosen calls the function."""


def main() -> int:
    """Print the table; exit code 1 if a survivor has no reason."""
    reasons = REASONS.read_text() if REASONS.exists() else ""
    open_ones: list[str] = []
    for path in sorted(Path("mutants/src").rglob("*.meta")):
        codes: dict[str, int | None] = json.loads(path.read_text())["exit_code_by_key"]
        count = Counter(codes.values())
        judged = sum(number for code, number in count.items() if code is not None)
        if not judged:
            continue
        killed = judged - count[SURVIVED] - count[UNTESTED]
        name = str(path.relative_to("mutants/src/handctl")).removesuffix(".py.meta")
        left = f"{count[SURVIVED]:4} survived {count[UNTESTED]:4} untested {count[None]:4} not run"
        print(f"{name:32} {killed:4} of {judged:4} killed {100 * killed / judged:5.1f} %  {left}")
        open_ones += [key for key, code in codes.items() if code == SURVIVED and f"`{key}`" not in reasons]
    for key in open_ones:
        print(f"no reason: {key}   (mutmut show {key})")
    return 1 if open_ones else 0


if __name__ == "__main__":
    sys.exit(main())
