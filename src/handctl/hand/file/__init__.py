"""The hand file: its sections and quantities, what is checked, and what its messages say."""
