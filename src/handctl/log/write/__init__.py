"""Writing of logs.

A recorder process writes the file, and the controller sends records to it through a pipe.
"""
