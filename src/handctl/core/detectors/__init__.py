"""Compiled fault detectors, which compare the measurements of a tick with a model of the hand."""
