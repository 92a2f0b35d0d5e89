"""Computations of a control tick: model of the hand, estimation of the hand's state, fault detectors, and control law."""
