"""Verbs that run a hand, or a simulated one."""
