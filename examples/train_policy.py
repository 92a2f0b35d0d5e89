"""Train a linear policy to follow a reference, by augmented random search.

The training takes one minute on an idle core.

All digits of the hand use the same policy. The action for a digit is a weighted sum of four values:
the future reference (when the hand reaches the target), the present reference, the angle of the
digit, and 1. The references and the angle have the same scale as an action.

pip install '.[gym]' in a copy of the repository
python train_policy.py [iterations] writes policy.npy and training.png.

Source: Mania, Guy, Recht, "Simple random search of static linear policies is competitive for reinforcement learning",
NeurIPS 2018, algorithm ARS V1.
"""

import sys

import gymnasium
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

import handctl.gym

ITERATION_COUNT = int(sys.argv[1]) if len(sys.argv) > 1 else 25
DIRECTION_COUNT, BEST_COUNT, STEP_SIZE, STEP_DECAY, NOISE_SIZE = 4, 4, 0.12, 0.93, 0.05
INPUT_NAMES = ("reference_ahead_rad", "reference_rad", "q_rad")
TEST_SEEDS = range(1001, 1006)
LINE_COLORS = (
    "#3b6fb6",
    "#d9822b",
    "#3c9d5d",
    "#b8436f",
)  # one colour for each digit, as in the figures of handctl

env = gymnasium.make("handctl/Track-v0", duration_s=2.0).unwrapped
assert isinstance(env, handctl.gym.TrackEnv)
names = np.array([name.partition("[")[0] for name in env.layout.names])


def policy_action(policy, observation):
    """Return the action of a policy for an observation.

    A policy is an array of weights (inputs + 1,). The last weight belongs to the constant 1.
    """
    input_angles = [np.degrees(observation[names == name]) for name in INPUT_NAMES]
    # matrix that converts joint angles to digit angles
    input_angles[-1] = env.coordinates_of_joints(input_angles[-1])
    scaled = [
        2.0 * (angles - env.low_deg) / (env.high_deg - env.low_deg) - 1.0 for angles in input_angles
    ]
    return np.clip(policy @ [*scaled, np.ones(len(env.names))], -1.0, 1.0).astype(np.float32)


def run_episode(policy, seed):
    """Run an episode with a policy.

    Return the mean reward, and the angles and references of the digits in each step [deg].
    """
    observation, _ = env.reset(seed=seed)
    rewards, rows, ended, is_truncated = [], [], False, False
    while not (ended or is_truncated):
        observation, reward, ended, is_truncated, _ = env.step(policy_action(policy, observation))
        rewards.append(reward)
        rows.append([np.degrees(env.coordinates_of_joints(env.true_q)), env.reference_deg(env.t_s)])
    return sum(rewards) / env.max_steps, np.array(rows)


rng = np.random.default_rng(0)
policy = np.zeros(len(INPUT_NAMES) + 1)
first_policy = policy.copy()
curve = []
for iteration in range(ITERATION_COUNT):
    directions = rng.standard_normal((DIRECTION_COUNT, len(policy)))
    # both policies (weights plus and minus a perturbation) are tried with the same episode
    seed = int(rng.integers(1000))
    scores = np.array(
        [
            [run_episode(policy + sign * NOISE_SIZE * d, seed)[0] for sign in (1, -1)]
            for d in directions
        ]
    )
    best = np.argsort(scores.max(axis=1))[-BEST_COUNT:]
    slope = sum((scores[i, 0] - scores[i, 1]) * directions[i] for i in best)
    policy += STEP_SIZE * STEP_DECAY**iteration / (BEST_COUNT * scores[best].std() + 1e-9) * slope
    curve.append(np.mean([run_episode(policy, seed)[0] for seed in TEST_SEEDS]))
    print(
        f"iteration {iteration + 1}: mean reward {curve[-1]:.3f} of 1, weights {policy.round(2)}",
        flush=True,
    )

np.save("policy.npy", policy)
rows_before, rows_after = (run_episode(p, TEST_SEEDS[0])[1] for p in (first_policy, policy))
figure, axes = plt.subplots(1, 3, figsize=(11, 3.4), layout="constrained")
axes[0].plot(range(1, ITERATION_COUNT + 1), curve, ".-")
axes[0].set(xlabel="iteration", ylabel="mean reward", ylim=(0, 1), title="Test episodes")
t = env.step_s * np.arange(1, env.max_steps + 1)
for axis, rows, title in ((axes[1], rows_before, "Before"), (axes[2], rows_after, "After")):
    for d, name in enumerate(env.names):
        axis.plot(t[: len(rows)], rows[:, 0, d], color=LINE_COLORS[d], label=name)
        axis.plot(t[: len(rows)], rows[:, 1, d], "--", color=LINE_COLORS[d], linewidth=1.0)
    axis.set(xlabel="time [s]", ylabel="angle [deg], reference dashed", title=title)
axes[2].legend(fontsize="small")
figure.savefig("training.png", dpi=120)
