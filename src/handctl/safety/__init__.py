"""Declarations of faults, reactions, thresholds, and the choice of a reaction to the present faults."""
