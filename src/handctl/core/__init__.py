"""Computations of a tick: model of the hand, estimation, fault detectors and control law."""
