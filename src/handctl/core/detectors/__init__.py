"""Compiled fault detectors.

The detectors find the faults of a tick, and store values of earlier ticks.
"""
