"""Gains of the controller, their bounds, and the files that contain them.

The tension filter and the control loops are designed from the gains.
"""
