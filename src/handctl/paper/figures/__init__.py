"""Figures of the paper, drawn again as PNG and SVG."""
