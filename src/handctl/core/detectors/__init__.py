"""Compiled fault detectors: their memory between ticks, and the faults that they find in a tick."""
