"""Runs of a hand: from the check of its files, through the run, to the log and the verdict.

All commands and studies that run a hand share this code.
"""
