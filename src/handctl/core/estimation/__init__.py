"""From measurements to tensions, angles, contacts and forces, with their variances."""
