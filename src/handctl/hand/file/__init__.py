"""Hand file: sections, quantities, checks, and messages."""
