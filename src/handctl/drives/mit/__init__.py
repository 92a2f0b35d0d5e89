"""Motors with the MIT protocol: Damiao, and CubeMars with less feedback."""
