"""Command line of handctl.

The first word after ``handctl`` names the command. The modules call the name of the command the
verb. In ``handctl run``, the verb is ``run``.
"""
