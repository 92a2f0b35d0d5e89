"""Parsing of the command line: parser, renamed options, shell completion, optional packages of a verb."""
