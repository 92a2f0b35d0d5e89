"""Parsing of the command line: parser, renamed options, shell completion, and the optional packages of each command."""
