"""Estimation of tensions, joint angles, contacts and forces from measurements, with their variances."""
