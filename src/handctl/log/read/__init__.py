"""Reader of logs, also of incomplete and damaged log files."""
