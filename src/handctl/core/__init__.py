"""Computations of a control tick.

The computations use a model of the hand. They are the state estimation, the detection of faults,
and the control law.
"""
