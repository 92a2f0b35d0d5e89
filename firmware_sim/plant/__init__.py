"""The mechanics of the simulated hand.

MuJoCo computes the links and the contacts. This package computes the tendons and the rotors.
"""
