"""Fault declarations, imported in the order of the catalogue, by which faults are indexed."""

from handctl.safety.faults import bus, node, tendon, host  # noqa: F401, I001 - their order is that of the catalogue
