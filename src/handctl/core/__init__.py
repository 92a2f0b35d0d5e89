"""Computations of a control tick.

The computations are the state estimation, the detection of faults, and the control law. The state
estimation, the detection of faults and the control law use a model of the hand.
"""
