"""Simulated drives that use the CANopen profile CiA 402."""
