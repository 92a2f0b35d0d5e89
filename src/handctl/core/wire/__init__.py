"""Cyclic frames: tables of their signals, and conversion between frames and values of the state block."""
