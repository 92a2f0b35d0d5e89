"""Writing of log files.

A recorder process writes the file. The controller sends records to this process through a pipe.
"""
