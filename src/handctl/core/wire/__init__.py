"""Cyclic frames: their tables, and their conversion to and from values of the state block."""
