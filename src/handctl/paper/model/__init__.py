"""Equations and numbers of the paper, each compared with the correct equation or the correct number."""
