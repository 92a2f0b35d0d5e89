"""Declarations of all faults.

The order of the imports determines the index of each fault in the fault table, so the modules are
imported in the order of the catalogue.
"""

from handctl.safety.faults import bus, node, tendon, host  # noqa: F401, I001 - the order of the catalogue
