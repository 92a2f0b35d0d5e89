"""Simulated ODrive."""
