"""Report the result of a mutation test.

The report has the score of each module, and the surviving mutants for which
docs/evidence/mutation.md gives no reason.
"""

import json
import sys
from collections import Counter
from pathlib import Path

EXPLANATIONS_FILE = Path("docs/evidence/mutation.md")
SURVIVED_CODES, UNTESTED_CODES, NOT_RUN_CODES = (0,), (5, 33), (None, 2, 34)
"""Exit codes of mutants in the records of mutmut.

In the first group, no test failed. In the second group, no selected test calls the mutated
function. In the third group, mutmut did not run the mutant.
"""


def main() -> int:
    """Print a table of the scores, and the surviving mutants for which docs/evidence/mutation.md gives no reason.

    Return 1 if a surviving mutant has no reason in docs/evidence/mutation.md, or if the mutation
    test has not finished any mutant.
    """
    reasons = EXPLANATIONS_FILE.read_text() if EXPLANATIONS_FILE.exists() else ""
    unexplained_mutants = list[str]()
    executed_mutant_total = 0
    for path in sorted(Path("mutants/src").rglob("*.meta")):
        codes: dict[str, int | None] = json.loads(path.read_text())["exit_code_by_key"]
        count = Counter(codes.values())
        survived, untested, not_run = (
            sum(count[code] for code in kind)
            for kind in (SURVIVED_CODES, UNTESTED_CODES, NOT_RUN_CODES)
        )
        executed_mutant_count = len(codes) - not_run
        if not executed_mutant_count:
            continue
        executed_mutant_total += executed_mutant_count
        killed_count = executed_mutant_count - survived - untested
        name = str(path.relative_to("mutants/src/handctl")).removesuffix(".py.meta")
        counts = f"{survived:4} survived {untested:4} untested {not_run:4} not run"
        print(
            f"{name:32} {killed_count:4} of {executed_mutant_count:4} killed "
            f"{100 * killed_count / executed_mutant_count:5.1f} %  {counts}"
        )
        unexplained_mutants += [
            key
            for key, code in codes.items()
            if code in SURVIVED_CODES + UNTESTED_CODES and f"`{key}`" not in reasons
        ]
    for key in unexplained_mutants:
        print(f"no reason: {key}   (mutmut show {key})")
    if not executed_mutant_total:
        print("no mutant was judged")
    return 1 if unexplained_mutants or not executed_mutant_total else 0


if __name__ == "__main__":
    sys.exit(main())
