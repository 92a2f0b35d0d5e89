"""Runs of a hand.

This package checks the files of a run, executes the run, and writes the log and the judgement of
the run. All commands and studies that run a hand use this package.
"""
