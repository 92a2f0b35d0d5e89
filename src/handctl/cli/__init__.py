"""Command line of handctl.

The first word of a command line is the verb, for example ``run`` in ``handctl run``.
"""
