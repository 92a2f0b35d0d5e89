"""Format of the hand file: sections, quantities, checks of the content, and messages about mistakes."""
