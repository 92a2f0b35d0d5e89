"""Draw the figures of the README and of the documentation site.

``make figures`` draws all figures in one style, from runs of the simulated hand.
"""
