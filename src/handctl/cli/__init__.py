"""Command line of handctl.

The first word after ``handctl`` names the command. The modules call this word the verb. In
``handctl run``, the verb is ``run``.
"""
