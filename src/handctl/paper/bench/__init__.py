"""Experiments of the paper about the hand `jamia`, repeated with a simulated hand."""
