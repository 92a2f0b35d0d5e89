"""Identification of the parameters of a hand: excitation of its digits, fit of a model, and identifiability."""
