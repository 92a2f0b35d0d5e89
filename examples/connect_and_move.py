"""Move a hand, hold a tension with one digit, and read an observation.

Start a simulated hand in another terminal: handctl sim --hand jamia --bus local:lab --scene none
When the hand is ready, start: python connect_and_move.py [options of handctl run, e.g. --rate 250]
"""

import sys

import handctl

with handctl.connect(
    "jamia", "local:lab", *sys.argv[1:]
) as hand:  # starts a controller, commissions and arms the hand
    hand.move(
        index=30, middle=30, ring=30, duration_s=0.8
    )  # one angle for all joints of a digit [deg]
    hand.hold(thumb=10)  # tension in every tendon of the thumb [N]
    observation = hand.observe()
    for name, angle in zip(hand.description.joints, observation.q_deg, strict=True):
        print(f"{name:10} {angle:6.1f} deg")
    print("tensions [N]:", observation.named("tension_N"))
    hand.move(index=0, middle=0, ring=0, thumb=0, duration_s=0.8)
print("log:", hand.result["log"])
