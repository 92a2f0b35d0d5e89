"""Diagnosis of a bus, an interface or a drive, without a controller."""
