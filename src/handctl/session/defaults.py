"""Defaults of the command line.

The module has no imports, so that every verb can import it quickly.
"""

DEFAULT_HAND = "jamia"
"""Default hand on a simulated bus. On a real bus the operator must name the hand."""
