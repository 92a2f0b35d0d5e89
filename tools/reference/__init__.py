"""Blocks of the reference pages, generated from the code: ``python -m tools.reference`` writes them into docs/."""
