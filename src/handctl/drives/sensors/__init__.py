"""Sensor node of a hand on CAN, with load cells and joint encoders."""
