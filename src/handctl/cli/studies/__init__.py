"""Verbs that run many simulations of a hand: fault studies and the source paper."""
