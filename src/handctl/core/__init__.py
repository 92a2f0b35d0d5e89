"""Computations of a control tick: model of the hand, state estimation, fault detectors, and control law."""
