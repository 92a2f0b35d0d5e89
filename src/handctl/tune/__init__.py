"""Tuning of a hand: identify its unknown parameters, design gains, search for better gains, verify them."""
