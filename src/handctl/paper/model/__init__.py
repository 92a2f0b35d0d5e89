"""Equations and numbers of the paper. Each is compared with the correct equation or the correct number."""
