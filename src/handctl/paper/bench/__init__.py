"""Experiments of the paper, carried out with the simulated hand."""
