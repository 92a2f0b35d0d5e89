"""Export of a log to the formats of other tools."""
