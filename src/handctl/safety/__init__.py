"""Fault declarations, reactions, thresholds, and the judge, which chooses a reaction to the present faults."""
