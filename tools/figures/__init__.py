"""Figures of the README and the site, drawn by ``make figures`` in one style from runs of the simulated hand."""
