"""Coverage-guided fuzzing of all parsers of foreign input: ``make fuzz``, ``python -m fuzz --help``.

A target reads bytes, raises only the declared errors, and returns True if it accepted the bytes.
The project imports nothing from here.
"""
