"""Sensor node: load cells and joint encoders."""
