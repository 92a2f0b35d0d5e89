"""Stream a sine of 1 Hz to a digit at 100 Hz, and plot the motion of the digit beside the sine.

Start in another terminal: handctl sim --hand jamia --bus local:lab --scene none
Then start: python stream_sine.py [options of handctl run] writes sine.png.
"""

import math
import sys

import matplotlib

matplotlib.use("Agg")  # draws into files and needs no screen
import matplotlib.pyplot as plt
import numpy as np

import handctl
from handctl.log.read.reader import RunLog

MIDDLE_DEG, SWING_DEG, DURATION_S = 30.0, 20.0, 3.0

with handctl.connect("jamia", "local:lab", *sys.argv[1:]) as hand:
    hand.move(index=MIDDLE_DEG)
    first = hand.observe().k
    with hand.stream(rate_Hz=100, space="digit", names=["index"]) as stream:
        for tick in range(round(DURATION_S * stream.rate_Hz)):
            t = (
                tick / stream.rate_Hz + stream.horizon_s
            )  # time at which the hand must reach the target
            stream.send([MIDDLE_DEG + SWING_DEG * math.sin(2.0 * math.pi * t)])
            stream.sleep()
        print(stream.status)
        last = hand.observe().k
    hand.move(index=0)

with RunLog(
    hand.result["log"]
) as log:  # the log has all ticks, but this program has observed only some of them
    streamed = (log.k > first) & (log.k < last)
    joints = [name.startswith("index") for name in log.names("q")]
    t = log.times[streamed]
    q, goal = (
        np.degrees(log.field(name)[streamed][:, joints]).mean(axis=1) for name in ("q", "q_goal")
    )
print(f"RMS of the tracking error: {np.sqrt(np.mean((q - goal) ** 2)):.2f} deg")

figure, (above, below) = plt.subplots(2, sharex=True, figsize=(7, 4.5), layout="constrained")
above.plot(t - t[0], goal, "k--", label="reference")
above.plot(t - t[0], q, label="estimated")
above.set(ylabel="mean angle of index [deg]", title="1 Hz streamed at 100 Hz")
above.legend(loc="upper right")
below.plot(t - t[0], q - goal)
below.set(xlabel="time [s]", ylabel="error [deg]")
figure.savefig("sine.png", dpi=120)
