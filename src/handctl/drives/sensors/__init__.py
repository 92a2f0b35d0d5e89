"""The sensor node: load cells and joint encoders."""
