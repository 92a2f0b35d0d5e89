"""Compiled fault detectors: update of their memory between ticks, and search for the faults of a tick."""
