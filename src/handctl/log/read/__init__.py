"""Reader of logs. The reader also accepts incomplete and damaged log files."""
