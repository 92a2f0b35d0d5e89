"""Reader of logs, complete and broken."""
