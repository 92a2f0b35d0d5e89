"""Experiments of the paper, repeated with the simulated hand."""
