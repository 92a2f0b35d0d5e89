"""Inputs of the safety monitor: the thresholds for a hand, and the number of excess replies from nodes."""
