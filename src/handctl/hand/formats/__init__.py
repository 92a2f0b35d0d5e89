"""Export of a hand to the file formats of other tools, and import from robot descriptions."""
