"""Tuning of a hand.

A tuning has four steps: identify the unknown parameters of the hand, design gains, search for
better gains, and verify the new gains on the hand.
"""
