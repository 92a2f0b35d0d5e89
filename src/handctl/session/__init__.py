"""Runs of a hand, from checked files to log and verdict: the part common to all verbs and studies."""
