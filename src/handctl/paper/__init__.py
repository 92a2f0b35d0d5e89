"""Reproduction of the source paper: every equation, number, and figure, with the errors in the print."""
