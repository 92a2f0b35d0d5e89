"""Export of a hand to the file formats of other tools, and import of robot descriptions."""
