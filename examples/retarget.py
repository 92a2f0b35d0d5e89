"""Let a robot hand follow the fingertips of a human hand.

The program scales the positions of the human fingertips to the lengths of the robot's fingers.

In another terminal: handctl sim --hand jamia11 --bus local:lab --scene none
When the hand is ready: python retarget.py [options of handctl run] writes retarget.png.

This program computes the human motion: index, middle, ring and thumb close one after another, and
after that they open. The lengths of the human finger segments are fractions of the hand's length
(Buchholz, Armstrong and Goldstein 1992, Ergonomics 35(3), 261-273). The last joint of a finger
turns by 2/3 of the angle of the middle joint (Rijpkema and Girard 1991).
"""

import sys

import matplotlib

matplotlib.use("Agg")  # matplotlib draws into files and needs no screen
import matplotlib.pyplot as plt
import numpy as np

import handctl
from handctl.client import Fingertips
from handctl.hand.digit import DigitModel
from handctl.hand.kinematics import to_palm_frame
from handctl.log.read.reader import RunLog

RATE_HZ = 50.0
DURATION_S = 6.0
HAND_LENGTH_M = 0.189
SEGMENT_FRACTIONS = {  # proximal, middle and distal segment as fractions of the hand's length
    "index": (0.245, 0.143, 0.097),
    "middle": (0.266, 0.170, 0.108),
    "ring": (0.244, 0.165, 0.107),
    "thumb": (0.196, 0.158),
}
CLOSED_ANGLES_DEG = {
    "index": 36.0,
    "middle": 30.0,
    "ring": 30.0,
    "thumb": 8.0,
}  # at larger joint angles, the fingers would touch the thumb


def human_tip(finger_name, t):
    """Return the position of a human fingertip relative to the knuckle [m].

    The x axis points along the straight finger, and the y axis in the closing direction.
    """
    delay = 0.4 * list(SEGMENT_FRACTIONS).index(finger_name)
    phase = np.clip((t - 0.5 - delay) / 3.5, 0.0, 1.0)
    knuckle = (
        np.radians(CLOSED_ANGLES_DEG[finger_name]) * 0.5 * (1.0 - np.cos(2.0 * np.pi * phase))
    )  # closes and opens
    turns = [knuckle, 1.1 * knuckle, 2.0 / 3.0 * 1.1 * knuckle][
        : len(SEGMENT_FRACTIONS[finger_name])
    ]
    angles = np.cumsum(turns)
    lengths = HAND_LENGTH_M * np.array(SEGMENT_FRACTIONS[finger_name])
    return np.array([lengths @ np.cos(angles), lengths @ np.sin(angles), 0.0])


def retargeted_tip(digit, finger_name, t):
    """Return the position of a human fingertip in the frame of the robot's palm [m].

    The function scales the position by the ratio of the finger lengths.
    """
    scale = sum(digit.lengths) / (HAND_LENGTH_M * sum(SEGMENT_FRACTIONS[finger_name]))
    return to_palm_frame(digit, scale * human_tip(finger_name, t))


with handctl.connect("jamia11", "local:lab", *sys.argv[1:]) as hand:
    digits = {name: DigitModel.from_hand(hand.description, name) for name in SEGMENT_FRACTIONS}
    tips = Fingertips(hand.description, list(SEGMENT_FRACTIONS))
    hand.move(
        tips.angles_deg(
            {name: retargeted_tip(digits[name], name, 0.0) for name in SEGMENT_FRACTIONS}
        )
    )
    first_tick = hand.observe().k
    distances_m = []
    with hand.stream(RATE_HZ, "fingertip", list(SEGMENT_FRACTIONS)) as stream:
        began_s = hand.observe().t_s
        for _ in range(round(DURATION_S * RATE_HZ)):
            # Time at which the hand must reach the target. The target time comes from the clock of
            # the hand. A time that is computed from the number of targets would lag behind after
            # each delay of the program.
            t = hand.observe().t_s - began_s + stream.horizon_s
            stream.send(
                np.array([retargeted_tip(digits[name], name, t) for name in SEGMENT_FRACTIONS])
            )
            distances_m.append(stream.fingertips.distances_m.copy())
            stream.sleep()
        print(stream.status)
        last_tick = hand.observe().k
distances_mm = 1e3 * np.array(distances_m)
print(
    f"error of the inverse kinematics: {distances_mm.mean():.2f} mm on average, {distances_mm.max():.2f} mm at most"
)

with RunLog(
    hand.result["log"]
) as log:  # the log has all ticks, but this program has observed only some of them
    streamed = (log.k > first_tick) & (log.k < last_tick)
    names = log.names("q")
    times = log.times[streamed]
    q = log.field("q")[streamed]
reached = np.array(
    [tips.tips(dict(zip(names, row, strict=True))) for row in q]
)  # (ticks, digits, 3)

figure, (paths, distances) = plt.subplots(
    2, len(SEGMENT_FRACTIONS), figsize=(11, 6), sharex="row", sharey="row", layout="constrained"
)
errors = []
for d, (name, ax) in enumerate(zip(SEGMENT_FRACTIONS, paths, strict=True)):
    digit = digits[name]
    human = np.array([retargeted_tip(digit, name, t) for t in times - began_s])
    path = [
        (points - digit.mount_position) @ digit.mount_rotation * 1e3
        for points in (human, reached[:, d])
    ]
    distance = np.linalg.norm(path[0] - path[1], axis=1)
    errors.append(np.sqrt(np.mean(distance**2)))
    ax.plot(path[1][:, 0], path[1][:, 1], label="robot")
    ax.plot(path[0][:, 0], path[0][:, 1], "k--", label="human, scaled")
    ax.plot(0.0, 0.0, "o", color="0.6", label="knuckle")
    ax.set(title=f"{name}: {errors[-1]:.1f} mm rms", xlabel="along the finger [mm]", aspect="equal")
    distances[d].plot(times - began_s, distance)  # equal paths can be passed at different times
    distances[d].set_xlabel("time [s]")
paths[0].set_ylabel("to the palm [mm]")
distances[0].set_ylabel("distance of the tips [mm]")
figure.legend(*paths[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
figure.savefig("retarget.png", dpi=120)
print(f"RMS distance of robot and human tips: {max(errors):.1f} mm in the worst finger")
