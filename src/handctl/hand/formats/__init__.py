"""Export of a hand to the formats of other tools."""
