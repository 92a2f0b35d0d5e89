"""Gains: their bounds, and the designs that follow from them."""
