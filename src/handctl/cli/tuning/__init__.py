"""Verbs on gains and on what a hand is made of."""
