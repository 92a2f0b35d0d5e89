"""Log writers that benchmarks/logging.py compares."""
