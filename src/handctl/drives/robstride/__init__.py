"""RobStride motors with their private protocol, which has 29-bit identifiers, or in MIT mode."""
