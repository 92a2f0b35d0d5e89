"""Coverage-guided fuzzing of all parsers of foreign input.

Run ``make fuzz``, or see ``python -m fuzz --help``.

A target is a function for feeding bytes to a parser, and returns True if the parser accepts the
bytes. Only errors declared by the parser may occur. handctl imports nothing from this package.
"""
