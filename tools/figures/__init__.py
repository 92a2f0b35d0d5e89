"""The figures of the README and the site.

``make figures`` draws them in one style, from runs of the simulated hand.
"""
