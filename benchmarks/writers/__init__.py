"""Writers of logs, which benchmarks/logging.py compares."""
