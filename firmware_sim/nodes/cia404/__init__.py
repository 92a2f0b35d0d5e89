"""The simulated CiA 404 measuring amplifier."""
