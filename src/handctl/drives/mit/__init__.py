"""Motors that speak the MIT protocol: Damiao's, and CubeMars' with less to tell."""
