"""Reproduction of the paper about the hand `jamia`.

The package repeats the equations, numbers and figures of the paper, and lists its errors.
"""
