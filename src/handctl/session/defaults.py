"""Defaults of the command line. The module imports nothing, so that every verb can read it."""

DEFAULT_HAND = "jamia"
"""Default hand on a simulated bus. On a real bus the operator must name the hand."""
