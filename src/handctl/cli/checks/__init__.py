"""Verbs that look before a hand is run: files, machine, buses, drives."""
