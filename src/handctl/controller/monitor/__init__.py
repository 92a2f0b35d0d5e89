"""Inputs of the safety monitor: the thresholds for a hand, and the replies without a request."""
