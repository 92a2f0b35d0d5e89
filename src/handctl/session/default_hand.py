"""Default values of the command line.

This module imports no other module, so that every command can import it fast.
"""

DEFAULT_HAND = "jamia"
"""Name of the default hand.

The default hand applies to simulated buses, because the operator must name the hand on a real bus.
"""
