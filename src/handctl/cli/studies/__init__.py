"""Commands that run many simulations of a hand: fault studies, and the reproduction of the source paper."""
