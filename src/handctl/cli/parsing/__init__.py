"""The command line as text: parser, renamed options, completion in a shell, optional packages of a verb."""
