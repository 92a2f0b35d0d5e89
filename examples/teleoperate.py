"""Teleoperate a hand: lines on the standard input, such as "index=30 thumb=10" [deg], are its targets.

In another terminal: handctl sim --hand jamia --bus local:lab --scene none
Then: python teleoperate.py [options of handctl run]

Any leader that can print works: a data glove, a camera, another program. The latest line counts. The targets approach
it at a bounded speed. The program ends with its input: printf 'index=40\\nindex=0\\n' | python teleoperate.py
"""

import os
import select
import sys

import numpy as np

import handctl

SPEED_DEG_S = 60.0


def lines():
    """Yield, without waiting, the lines that have come since the last call. Stop at the end of the input."""
    rest = b""
    while True:
        if select.select([0], [], [], 0.0)[0]:
            part = os.read(0, 4096)
            if not part:
                return
            rest += part
        *complete, rest = rest.split(b"\n")
        yield [line.decode() for line in complete]


with handctl.connect("jamia", "local:lab", *sys.argv[1:]) as hand:
    names = hand.description.digit_names
    targets = dict.fromkeys(names, 0.0)
    with hand.stream(rate_Hz=50, space="digit") as stream:
        angles = np.zeros(len(names))
        largest = SPEED_DEG_S / stream.rate_Hz
        source = lines()
        new = next(source, None)
        while new is not None or not np.allclose(angles, list(targets.values())):
            for word in " ".join(new or []).split():
                name, _, value = word.partition("=")
                if name in targets:
                    targets[name] = float(value)
            angles += np.clip(np.array(list(targets.values())) - angles, -largest, largest)
            stream.send(angles)
            stream.sleep()
            if new is not None:
                new = next(source, None)
        print("at the end:", hand.observe().q_deg.round(1))
        print(stream.status)
