"""What verbs have in common: options, output, the screen, and what an operator is asked."""
