"""Inputs of the safety monitor: the thresholds of a hand, and replies beyond the requests."""
