"""Coverage-guided fuzzing of everything that reads what others wrote; ``make fuzz``, ``python -m fuzz --help``.

A target takes bytes and lets nothing out but the errors that are declared; what it returns is whether they were
accepted. Nothing here is imported by the project.
"""
