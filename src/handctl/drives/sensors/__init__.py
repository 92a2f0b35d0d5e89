"""Sensor node of a hand on CAN.

A sensor node has load cells and joint encoders.
"""
