"""Verbs that try a simulated hand many times: faults, and the source paper."""
