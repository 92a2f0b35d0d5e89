"""Computations of a control tick.

The package contains the state estimation, the detection of faults, and the control law. All three
parts use a model of the hand.
"""
