"""Gains: their bounds, their files, and the designs of the tension filter and of the control loops from them."""
