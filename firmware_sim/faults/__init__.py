"""Faults of a simulated hand: their text form, faults of the plant, and faults of the wire."""
