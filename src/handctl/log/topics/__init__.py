"""Topics of a log. The modules in this folder convert batches of ticks to blocks of messages."""
