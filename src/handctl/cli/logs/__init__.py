"""Verbs that read logs."""
