"""Coverage-guided fuzzing of all parsers of handctl whose input comes from outside of handctl.

Run ``make fuzz``, or see ``python -m fuzz --help``.

A fuzzing target is a function that feeds bytes to a parser, and returns True if the parser accepts
the bytes. The parser is allowed to raise only its declared errors. The package ``handctl`` imports
nothing from the package ``fuzz``.
"""
