"""Compiled fault detectors.

The detectors find the faults of a tick. They store values of earlier ticks.
"""
