"""Cyclic frames: their tables, and the conversion between frames and values of the state block."""
