"""Verbs that check files, machine, buses and drives before a run."""
