"""Simulated drives that use ODrive's protocol CANSimple."""
