"""Defaults of the command line.

The module imports nothing. Therefore every command can import it quickly.
"""

DEFAULT_HAND = "jamia"
"""Name of the default hand, for simulated buses.

For a real bus, the operator must name the hand.
"""
