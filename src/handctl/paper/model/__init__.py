"""Equations and numbers of the paper, compared with the correct equations and the correct numbers."""
