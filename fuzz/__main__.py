"""Fuzz each parser for the requested time and print the results.

The exit code is 1 if a parser raised an undeclared exception.
"""

import argparse
import re
import subprocess
import sys
from pathlib import Path

from fuzz.fuzzed_drives import FUZZED_DRIVES

OUTPUT_FOLDER = Path("build/fuzz")
RUN_COUNT_PATTERN = re.compile(r"Done (\d+) runs in (\d+) second(?:\(s\), (\d+) inputs accepted)?")
COVERAGE_PATTERN = re.compile(r"cov: (\d+) ft: (\d+)")
TARGET_NAMES = (*FUZZED_DRIVES, "sensor-node", "hand", "hand-text", "task", "trajectory", "gains", "calibration",
         "log", "log-bytes", "request", "fault")  # fmt: skip
MAX_INPUT_BYTES = {**dict.fromkeys(FUZZED_DRIVES, 64), "sensor-node": 64, "request": 256, "fault": 256, "hand": 128,
           "task": 128, "trajectory": 128, "gains": 128, "calibration": 128, "hand-text": 1 << 14, "log": 4096,
           "log-bytes": 1 << 16}  # fmt: skip
"""Maximum length of the inputs of each fuzzing target [bytes].

The initial inputs of a fuzzing target are not longer than the maximum.
"""


def parsed_arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(prog="python -m fuzz", description=__doc__)
    parser.add_argument(
        "targets",
        nargs="*",
        metavar="TARGET",
        help=f"parsers: {', '.join(TARGET_NAMES)} (default: all)",
    )
    parser.add_argument(
        "--seconds",
        type=int,
        default=10,
        help="duration for each target (default: %(default)s; 0: no limit)",
    )
    parser.add_argument(
        "--runs", type=int, default=-1, help="inputs for each target (default: limited by time)"
    )
    parser.add_argument(
        "--blind",
        action="store_true",
        help="do not measure which branches an input reaches (faster)",
    )
    args = parser.parse_args()
    if unknown_targets := set(args.targets) - set(TARGET_NAMES):
        parser.error(
            f"no target {sorted(unknown_targets)[0]!r}; expected one of {', '.join(TARGET_NAMES)}"
        )
    return args


def fuzz_target(
    target_name: str, duration_s: int, run_count: int, without_coverage: bool = False
) -> tuple[str, bool]:
    """Fuzz one fuzzing target in a separate process.

    Return a line that describes the result, and True if the target passed. A target passes if its
    parser raised only expected exceptions. In a run without coverage, the parser must also accept
    at least one input.
    """
    corpus_folder = OUTPUT_FOLDER / "corpus" / target_name
    crash_folder = OUTPUT_FOLDER / "found" / target_name
    corpus_folder.mkdir(parents=True, exist_ok=True)
    crash_folder.mkdir(parents=True, exist_ok=True)
    limits = [
        f"-max_total_time={duration_s}",
        f"-runs={run_count}",
        f"-max_len={MAX_INPUT_BYTES[target_name]}",
    ]
    limits += ["-rss_limit_mb=4096", "-timeout=20", f"-artifact_prefix={crash_folder}/"]
    command = [
        sys.executable,
        "-m",
        "fuzz.fuzz_with_coverage",
        target_name,
        str(corpus_folder),
        *limits,
    ]
    if without_coverage:
        command = [
            sys.executable,
            "-m",
            "fuzz.fuzz_without_coverage",
            target_name,
            str(corpus_folder),
            str(crash_folder),
            str(duration_s),
            str(run_count),
        ]
        command.append(str(MAX_INPUT_BYTES[target_name]))
    process_result = subprocess.run(
        command, capture_output=True, text=True, errors="replace", check=False
    )
    (OUTPUT_FOLDER / f"{target_name}.txt").write_text(process_result.stdout + process_result.stderr)
    run_count_match = RUN_COUNT_PATTERN.search(process_result.stderr)
    coverage_counts = COVERAGE_PATTERN.findall(process_result.stderr)
    if process_result.returncode or not run_count_match:
        return (
            f"{target_name:13} FAILED  see {OUTPUT_FOLDER / target_name}.txt and {crash_folder}/",
            False,
        )
    number = int(run_count_match[1])
    elapsed_s = max(1, int(run_count_match[2]))
    if without_coverage and not int(run_count_match[3]):
        return (
            f"{target_name:13} FAILED  none of {number:,} inputs was accepted: only the first check was tested",
            False,
        )
    edge_count_text = f"edges {coverage_counts[-1][0]:>6}" if coverage_counts else "no edges"
    coverage_text = (
        f"blind, {100 * int(run_count_match[3]) / number:.1f} % accepted"
        if without_coverage
        else edge_count_text
    )
    return (
        f"{target_name:13} {number:>10,} inputs {elapsed_s:>6} s {number // elapsed_s:>8,}/s   "
        f"{coverage_text}",
        True,
    )


def main() -> int:
    """Fuzz all selected fuzzing targets, and return the exit code of the program."""
    args = parsed_arguments()
    all_passed = True
    for name in args.targets or TARGET_NAMES:
        line, has_passed = fuzz_target(name, args.seconds, args.runs, args.blind)
        print(line, flush=True)
        all_passed = all_passed and has_passed
    return 0 if all_passed else 1


if __name__ == "__main__":
    sys.exit(main())
