"""Declarations of faults, of the reactions to faults, and of thresholds.

The package also chooses the reaction to the faults that are present.
"""
