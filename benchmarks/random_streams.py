"""Send random angles to all digits of each packaged hand, and count the runs that end with a fault.

``python benchmarks/random_streams.py [--hands HAND ...] [--seeds N] [--seconds S] [--json]``. An
untrained policy sends a random target for every digit 50 times a second. The target angles are
anywhere in the range of the joints. The digits collide with each other and with the palm. Targets
of the kind *noise* are independent random angles. Targets of the kind *steps* keep a random angle
for 0.1 to 0.6 s. Targets of the kind *walk* add a random step to the last angle.
"""

import argparse
import collections
import json
import sys
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

import handctl.gym  # noqa: F401  # registers the environments
from handctl.gym.track import TrackEnv
from handctl.hand.hand_loading import packaged_hands

FloatArray = NDArray[np.float64]
UNLIMITED_SPEED_DEG_S = 1e6
"""Largest rate of change of the targets [deg/s].

The value is so large that it has no effect. Only the controller limits the rate of change of the
targets.
"""
RANDOM_WALK_STEP = 0.125
"""Standard deviation of one change of the angle in the random walk, as a fraction of the range of a joint."""


def draw_action(
    random_source: np.random.Generator, last_action: FloatArray, step_index: int
) -> FloatArray:
    """Return a random action that does not depend on the last action."""
    return random_source.uniform(-1.0, 1.0, len(last_action))


def draw_or_keep_action(
    random_source: np.random.Generator, last_action: FloatArray, step_index: int
) -> FloatArray:
    """Return either the last action or, at random moments, a new random action."""
    return (
        random_source.uniform(-1.0, 1.0, len(last_action))
        if step_index == 0 or random_source.random() < 1.0 / 17.0
        else last_action
    )


def take_random_step(
    random_source: np.random.Generator, last_action: FloatArray, step_index: int
) -> FloatArray:
    """Return the action that follows the last action in a random walk."""
    return np.clip(
        last_action + random_source.normal(0.0, 2.0 * RANDOM_WALK_STEP, len(last_action)), -1.0, 1.0
    )


ACTION_SOURCES: dict[str, Callable[[np.random.Generator, FloatArray, int], FloatArray]] = {
    "noise": draw_action,
    "steps": draw_or_keep_action,
    "walk": take_random_step,
}


def stream_random_targets(env: TrackEnv, source_name: str, seed: int) -> tuple[str, float]:
    """Send random targets to a hand until the end of the episode.

    A fault of the hand also ends the episode.

    Args:
        env: environment of the hand.
        source_name: name of the random targets.
        seed: seed of the simulated hand and of the targets.

    Returns:
        The text of the fault (empty if the hand had no fault), and the largest true tension [N].
    """
    env.reset(seed=seed)
    random_source = np.random.default_rng(seed)
    action = np.zeros(env.action_space.shape or ())
    largest = 0.0
    step = 0
    while True:
        action = ACTION_SOURCES[source_name](random_source, action, step)
        _, _, is_terminated, is_truncated, information = env.step(action.astype(np.float32))
        largest = max(
            largest,
            float(np.max(np.abs(list(env.simulated_run.simulated_hand.world.plant.tensions())))),
        )
        step += 1
        if is_terminated or is_truncated:
            return str(information["failure"]) if is_terminated else "", largest


def main() -> None:
    """Run all combinations of hand, kind of targets and seed, and print a row per hand."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--hands", nargs="*", default=list(packaged_hands()), help="packaged hands (default: all)"
    )
    parser.add_argument(
        "--seeds",
        type=int,
        default=5,
        help="number of runs for each hand and kind of target (default: 5)",
    )
    parser.add_argument(
        "--seconds", type=float, default=5.0, help="duration of a run [s] (default: 5)"
    )
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    args = parser.parse_args()
    table = []
    for hand in args.hands:
        env = TrackEnv(hand, "digit", duration_s=args.seconds, speed_deg_s=UNLIMITED_SPEED_DEG_S)
        faults: collections.Counter[str] = collections.Counter()
        largest = 0.0
        for kind in ACTION_SOURCES:
            for seed in range(args.seeds):
                print(f"{hand} {kind} seed {seed}", file=sys.stderr)
                fault, tension = stream_random_targets(env, kind, seed)
                largest = max(largest, tension)
                if fault:
                    faults[fault.split()[1]] += 1
        env.close()
        table.append(
            {
                "hand": hand,
                "runs": len(ACTION_SOURCES) * args.seeds,
                "faults": dict(faults),
                "largest_N": largest,
            }
        )
    if args.json:
        print(json.dumps(table))
        return
    print("| hand | runs | ended with a fault | largest true tension |\n|---|---|---|---|")
    for row in table:
        fault_text = ", ".join(f"{count} {name}" for name, count in row["faults"].items()) or "none"
        print(f"| {row['hand']} | {row['runs']} | {fault_text} | {row['largest_N']:.0f} N |")


if __name__ == "__main__":
    main()
