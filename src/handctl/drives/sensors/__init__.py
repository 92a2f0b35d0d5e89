"""Sensor node of a hand on CAN.

The node has load cells and joint encoders.
"""
