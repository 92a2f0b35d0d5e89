"""The mechanics of the simulated hand.

MuJoCo computes links and contacts. This package computes tendons and rotors.
"""
