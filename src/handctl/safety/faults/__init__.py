"""Declarations of all faults.

The modules are imported in the order of the catalogue, because the order of import numbers the
faults.
"""

from handctl.safety.faults import bus, node, tendon, host  # noqa: F401, I001 - the order of the catalogue
