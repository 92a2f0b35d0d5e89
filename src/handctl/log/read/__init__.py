"""Reader of logs. The reader also accepts log files that are incomplete or damaged."""
