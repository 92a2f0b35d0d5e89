"""Tuning of a hand whose friction is not known: identify its parameters, design gains, search for better gains, verify them."""
