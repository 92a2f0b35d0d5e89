"""Inputs of the safety monitor: the thresholds for a hand, and excess replies from nodes."""
