"""Faults that a user injects into a simulated hand: their text, and their effects on the plant and on frames."""
