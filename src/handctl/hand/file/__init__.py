"""Format of the hand file: its sections and quantities, the checks of its content, and their messages."""
