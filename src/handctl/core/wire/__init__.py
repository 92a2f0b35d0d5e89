"""Cyclic frames.

The modules contain tables of the signals, and convert frames to values of the state block and back.
"""
