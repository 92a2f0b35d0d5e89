"""Simulated moteus controllers."""
