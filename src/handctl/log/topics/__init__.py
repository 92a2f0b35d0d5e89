"""Topics of a log, which are the named series of messages in it.

The modules of this folder convert batches of ticks to blocks of messages.
"""
