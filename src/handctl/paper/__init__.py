"""Reproduction of the paper that describes the hand `jamia`.

The package repeats the equations, the numbers and the figures of the paper, and lists the errors of
the paper.
"""
