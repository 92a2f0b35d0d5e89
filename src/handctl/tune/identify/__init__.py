"""Identification of a hand's parameters: excitation, fit, identifiability."""
