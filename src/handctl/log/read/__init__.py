"""Reading a log, whole or broken."""
