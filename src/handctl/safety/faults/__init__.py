"""Fault declarations.

The modules are imported in the order of the catalogue, because this order numbers the faults.
"""

from handctl.safety.faults import bus, node, tendon, host  # noqa: F401, I001 - their order is that of the catalogue
