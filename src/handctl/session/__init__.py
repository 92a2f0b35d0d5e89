"""Runs of a hand, from checked files to log and verdict.

This code is common to all verbs and studies.
"""
