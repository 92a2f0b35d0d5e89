"""Format of the hand file: sections, quantities, checks, and messages."""
