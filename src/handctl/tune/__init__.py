"""Tuning of a hand with unknown friction: identify, design, search, verify."""
