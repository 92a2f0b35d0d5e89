"""Tuning of a hand with unknown friction: identify its parameters, design gains, search better gains, verify them."""
