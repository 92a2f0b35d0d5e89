"""Parsing of the command line: parser, renamed options, shell completion, and list of optional packages."""
