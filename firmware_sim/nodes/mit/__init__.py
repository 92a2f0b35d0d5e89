"""Simulated drives that use the MIT protocol."""
