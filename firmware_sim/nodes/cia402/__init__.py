"""Simulated drives that speak CiA 402 over CANopen."""
