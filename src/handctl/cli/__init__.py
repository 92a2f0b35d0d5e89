"""Command line of handctl.

The first word after ``handctl`` names the command, such as ``run`` in ``handctl run``. In the
modules of the command line, the word *verb* means the name of a command.
"""
