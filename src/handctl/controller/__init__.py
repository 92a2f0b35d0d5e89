"""Controller of a hand, written as pure functions.

The modules compute the tick, the modes of the hand, the state of the controller, the effect of
requests, the change of gains, and the shutdown.
"""
