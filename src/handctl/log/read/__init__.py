"""Reader for complete and for broken logs."""
