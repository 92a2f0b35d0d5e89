"""Stream a sine of 1 Hz to a digit at 100 Hz, and plot the motion of the digit beside the sine.

Start in another terminal: handctl sim --hand jamia --bus local:lab --scene none
When the hand is ready, start: python stream_sine.py [options of handctl run] writes sine.png.
"""

import sys

import matplotlib

matplotlib.use("Agg")  # matplotlib draws into files and needs no screen
import matplotlib.pyplot as plt
import numpy as np

import handctl
from handctl.log.read.reader import RunLog

SINE_MIDDLE_DEG, SINE_AMPLITUDE_DEG, DURATION_S = 30.0, 20.0, 3.0
SETTLING_S = 0.3  # the digit starts at rest, but the sine starts with its full speed


def sine_deg(t_s):
    """Return the target angle [deg] at the time ``t_s`` [s] after the start of the stream."""
    return SINE_MIDDLE_DEG + SINE_AMPLITUDE_DEG * np.sin(2.0 * np.pi * t_s)


with handctl.connect("jamia", "local:lab", *sys.argv[1:]) as hand:
    hand.move(index=SINE_MIDDLE_DEG)
    with hand.stream(rate_Hz=100, space="digit", names=["index"]) as stream:
        began_s = hand.observe().t_s
        # The time of a target comes from the clock of the hand. A time that is computed from the
        # number of targets would lag behind after each delay of the program.
        while (t := hand.observe().t_s - began_s) < DURATION_S:
            stream.send([sine_deg(t + stream.horizon_s)])  # the angle at the end of the horizon
            stream.sleep()
        print(stream.status)
    hand.move(index=0)

with RunLog(
    hand.result["log"]
) as log:  # the log has all ticks, but this program has observed only some of them
    streamed = (log.times > began_s + SETTLING_S) & (log.times < began_s + DURATION_S)
    joints = [name.startswith("index") for name in log.names("q")]
    t = log.times[streamed] - began_s
    q = np.degrees(log.field("q")[streamed][:, joints]).mean(axis=1)
print(f"RMS of the tracking error: {np.sqrt(np.mean((q - sine_deg(t)) ** 2)):.2f} deg")

figure, (above, below) = plt.subplots(2, sharex=True, figsize=(7, 4.5), layout="constrained")
above.plot(t, sine_deg(t), "k--", label="sine")
above.plot(t, q, label="estimated")
above.set(ylabel="mean angle of index [deg]", title="1 Hz streamed at 100 Hz")
above.legend(loc="upper right")
below.plot(t, q - sine_deg(t))
below.set(xlabel="time [s]", ylabel="error [deg]")
figure.savefig("sine.png", dpi=120)
