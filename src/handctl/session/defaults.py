"""What holds where an operator says nothing; imports nothing, so that every verb may read it."""

DEFAULT_HAND = "jamia"
"""The hand on a simulated bus where none is named; on a real bus one must be."""
