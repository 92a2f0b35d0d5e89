"""Gains: their bounds and files, and the designs of filter and control loops from them."""
