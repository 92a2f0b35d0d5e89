"""Simulated drives that speak ODrive's CANSimple protocol."""
