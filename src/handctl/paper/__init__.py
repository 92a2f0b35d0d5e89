"""Reproduction of the paper that describes the hand `jamia`: its equations, numbers and figures, with their errors."""
