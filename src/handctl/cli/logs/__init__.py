"""Verbs on logs."""
