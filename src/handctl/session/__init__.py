"""Runs of a hand.

This package executes a run: it checks the files, executes the run, and writes the log and the
verdict. All commands and studies that run a hand share this code.
"""
