"""Motors with the MIT protocol: Damiao, and CubeMars, whose feedback contains less."""
