"""Commands that read logs of runs."""
