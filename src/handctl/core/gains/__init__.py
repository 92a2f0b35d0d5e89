"""Gains: bounds, files, and the designs derived from gains."""
