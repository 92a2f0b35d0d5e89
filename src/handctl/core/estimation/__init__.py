"""Estimation: from measurements to tensions, angles, contacts and forces, with variances."""
