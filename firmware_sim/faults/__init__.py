"""Faults that a user injects into a simulated hand: their text form, and their effects on the plant and on frames."""
