"""Draw the figures: ``python -m tools.figures [NAME ...]``.

The program stores the runs in build/figures and the pictures in docs/figures.
"""

import argparse
import contextlib
import io
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from handctl.cli.main import main as handctl
from tools.figures import diagrams, gif, hands, numbers, plots, runs, tuning
from tools.figures.style import (
    FIGURES_FOLDER,
    apply_style,
    save_figure,
    stamp_picture,
    without_blanks,
)

REPOSITORY_ROOT = Path(__file__).parents[2]
RUNS_FOLDER = REPOSITORY_ROOT / "build" / "figures"
DIAGRAMS: dict[str, Callable[[], Any]] = {
    "architecture": diagrams.architecture_diagram, "control-law": diagrams.control_law_diagram,
    "wiring": diagrams.wiring_diagram,
    "tendon": diagrams.tendon_diagram, "modes": diagrams.modes_diagram,
}  # fmt: skip
PLOTS: dict[str, Callable[[Path], Any]] = {
    "estimate": plots.estimate_plot, "snapped-tendon": plots.snapped_tendon, "tip-force": plots.tip_force,
    "replay": plots.replay_plot, "bus-tick": plots.bus_tick,
}  # fmt: skip
PICTURES: dict[str, Callable[[Path], Path]] = {
    "run": runs.run_picture, "view": runs.view_picture, "gym-training": runs.training_picture,
    "report": tuning.report_picture, "orca-like": tuning.pair_picture, "meshes": tuning.mesh_picture,
    "identify": tuning.identify_picture, "tune-design": tuning.design_picture, "tune-return": tuning.return_picture,
    "tune-search": tuning.search_picture, "tune-verify": tuning.verify_picture,
    **{f"hand-{name}": hands.picture_of(name) for name in (*hands.PACKAGED_HANDS, *hands.EXAMPLE_HANDS)},
}  # fmt: skip


def draw_paper() -> None:
    """Draw the figures that repeat figures of the source paper with data of handctl.

    The data come from the experiments in docs/evidence.
    """
    results = REPOSITORY_ROOT / "docs" / "evidence" / "paper-results.json"
    with contextlib.redirect_stdout(io.StringIO()):
        handctl(["paper", "--json", "--figures", str(FIGURES_FOLDER), "--results", str(results)])
    for path in FIGURES_FOLDER.glob("paper-*.svg"):
        path.write_bytes(without_blanks(path.read_bytes()))


OTHER_WRITERS: dict[str, Callable[[], None]] = {
    "grasp": lambda: gif.write_gif(RUNS_FOLDER, FIGURES_FOLDER / "grasp.gif"),
    "numbers": lambda: numbers.write_numbers(REPOSITORY_ROOT, RUNS_FOLDER),
    "paper": draw_paper,
}  # fmt: skip
SLOW_PICTURES = ("tune-search", "tune-verify")
"""Pictures that take minutes each.

The program draws a slow picture only if the command line names it.
"""
FIGURE_NAMES = (*DIAGRAMS, *PLOTS, *PICTURES, *OTHER_WRITERS)


def main() -> int:
    """Draw the figures that the command line names, or all figures. Return the exit code."""
    parser = argparse.ArgumentParser(
        description="Draw the figures of README and site, and write the demo's numbers."
    )
    parser.add_argument("names", nargs="*", metavar="NAME",
                        help=f"{', '.join(FIGURE_NAMES)} "
                             f"(default: all but {', '.join(SLOW_PICTURES)}; report needs Chromium)")  # fmt: skip
    parser.add_argument(
        "--keep", action="store_true", help="use the demo's run in build/figures if it is there"
    )
    args = parser.parse_args()
    if unknown := set(args.names) - set(FIGURE_NAMES):
        parser.error(f"{min(unknown)}: no such figure; expected {', '.join(FIGURE_NAMES)}")
    apply_style()
    RUNS_FOLDER.mkdir(parents=True, exist_ok=True)
    if not args.keep:
        for path in RUNS_FOLDER.glob("grasp.*"):
            path.unlink()
    left_out = SLOW_PICTURES if tuning.find_browser() else (*SLOW_PICTURES, "report")
    if not args.names:
        print(f"left out: {', '.join(left_out)}", flush=True)
    for name in args.names or [name for name in FIGURE_NAMES if name not in left_out]:
        start = time.monotonic()
        if name in DIAGRAMS:
            save_figure(DIAGRAMS[name](), name)
        elif name in PLOTS:
            save_figure(PLOTS[name](RUNS_FOLDER), name)
        elif name in PICTURES:
            stamp_picture(PICTURES[name](RUNS_FOLDER), FIGURES_FOLDER / f"{name}.png")
        else:
            OTHER_WRITERS[name]()
        print(f"{name}: {time.monotonic() - start:.1f} s", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
