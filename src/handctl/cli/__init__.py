"""Command line of handctl."""
