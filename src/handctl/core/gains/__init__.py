"""Gains, their bounds and their files.

The tension filter and the control loops are designed from the gains.
"""
