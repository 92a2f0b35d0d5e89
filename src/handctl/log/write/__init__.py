"""Writing of log files.

A recorder process writes the file. The controller sends records to the recorder process through a
pipe.
"""
