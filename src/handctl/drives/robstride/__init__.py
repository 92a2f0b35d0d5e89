"""RobStride motors, with their private protocol or in MIT mode.

The private protocol has 29-bit identifiers.
"""
