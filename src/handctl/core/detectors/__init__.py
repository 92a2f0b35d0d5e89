"""Compiled fault detectors: memory between ticks, and findings of a tick."""
