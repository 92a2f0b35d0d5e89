"""Identification of the parameters of a hand: excitation of digits, fit of a model, and confidence."""
