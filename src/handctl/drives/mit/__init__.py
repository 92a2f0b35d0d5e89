"""Motors with the MIT protocol: Damiao motors, and CubeMars motors, whose feedback contains less data."""
