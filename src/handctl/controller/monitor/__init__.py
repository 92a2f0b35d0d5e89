"""Inputs of the safety monitor: the thresholds for a hand, and the number of replies that exceed the requests."""
