"""Fault declarations, reactions, thresholds, and the judge: faults in, a reaction out."""
