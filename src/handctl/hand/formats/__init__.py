"""A hand in the formats of other tools."""
