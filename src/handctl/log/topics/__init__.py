"""Topics of a log. The modules convert batches of ticks to blocks of messages."""
