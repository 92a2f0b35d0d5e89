"""Simulated drives of the CiA 402 profile."""
