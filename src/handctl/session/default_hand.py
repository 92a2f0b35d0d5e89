"""Default values of the command line.

This module imports no other module. Therefore its import by any command is fast.
"""

DEFAULT_HAND = "jamia"
"""Name of the default hand.

The default applies to simulated buses, because the operator must name the hand on a real bus.
"""
