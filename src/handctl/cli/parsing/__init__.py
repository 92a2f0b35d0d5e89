"""Parsing of the command line: parser, renamed options, shell completion, and optional packages."""
