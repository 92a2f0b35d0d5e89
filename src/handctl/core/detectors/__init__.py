"""Compiled fault detectors: what they remember from tick to tick, and what they find in one."""
