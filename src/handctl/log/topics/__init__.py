"""The topics of a log: a batch of ticks in, runs of messages out."""
