"""Coverage-guided fuzzing of all parsers of foreign input: ``make fuzz``, ``python -m fuzz --help``.

A target takes bytes, raises no exception but the declared errors, and returns True if it accepted the
bytes. The project imports nothing from here.
"""
