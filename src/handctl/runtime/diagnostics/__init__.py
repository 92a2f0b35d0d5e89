"""Diagnosis of a CAN bus, a network interface or a drive, while no controller runs."""
