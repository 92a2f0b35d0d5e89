"""Faults of a simulated hand: as text, in the plant, on the wire."""
