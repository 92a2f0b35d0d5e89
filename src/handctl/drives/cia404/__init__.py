"""CiA 404 measuring amplifiers for load cells over CANopen."""
