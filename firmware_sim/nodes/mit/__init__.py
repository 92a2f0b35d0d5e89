"""Simulated drives that speak the MIT protocol."""
