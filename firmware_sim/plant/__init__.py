"""The mechanics of the simulated hand.

MuJoCo computes links and contacts, this package tendons and rotors.
"""
