"""Declarations of faults, reactions and thresholds, and the choice of the reaction to present faults."""
