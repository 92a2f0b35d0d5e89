"""Teleoperate a hand with lines from the standard input, such as "index=30 thumb=10" with angles in degrees.

Start in another terminal: handctl sim --hand jamia --bus local:lab --scene none
When the hand is ready, start: python teleoperate.py [options of handctl run]

Any program that prints lines with digits and angles can move the hand, for example the program of a
data glove or of a camera. The latest line is the goal, and the targets of the stream approach the
goal with a limited speed. The program ends when its standard input ends:
printf 'index=40\\nindex=0\\n' | python teleoperate.py
"""

import os
import select
import sys

import numpy as np

import handctl

SPEED_DEG_S = 60.0


def arrived_lines():
    """Yield the lines that have arrived since the last call, without waiting.

    Stop at the end of the standard input.
    """
    incomplete_line = b""
    while True:
        if select.select([0], [], [], 0.0)[0]:
            input_bytes = os.read(0, 4096)
            if not input_bytes:
                return
            incomplete_line += input_bytes
        *complete, incomplete_line = incomplete_line.split(b"\n")
        yield [line.decode() for line in complete]


with handctl.connect("jamia", "local:lab", *sys.argv[1:]) as hand:
    names = hand.description.digit_names
    targets = dict.fromkeys(names, 0.0)
    with hand.stream(rate_Hz=50, space="digit") as stream:
        angles = np.zeros(len(names))
        largest = SPEED_DEG_S / stream.rate_Hz
        source = arrived_lines()
        new_lines = next(source, None)
        while new_lines is not None or not np.allclose(angles, list(targets.values())):
            for word in " ".join(new_lines or []).split():
                name, _, value = word.partition("=")
                if name in targets:
                    targets[name] = float(value)
            angles += np.clip(np.array(list(targets.values())) - angles, -largest, largest)
            stream.send(angles)
            stream.sleep()
            if new_lines is not None:
                new_lines = next(source, None)
        print("at the end:", hand.observe().q_deg.round(1))
        print(stream.status)
