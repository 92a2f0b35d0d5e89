"""The mechanics of a simulated hand.

The library MuJoCo computes the links and the contacts. The modules of this package compute the
tendons and the rotors.
"""
