"""The log writers that benchmarks/logging.py compares."""
