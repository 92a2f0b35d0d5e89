"""Computations of a control tick: model of the hand, estimation of its state, fault detectors and control law."""
