"""Topics of a log. They turn a batch of ticks into blocks of messages."""
