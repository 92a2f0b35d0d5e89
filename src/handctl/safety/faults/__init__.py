"""Declarations of all faults.

The order of the imports determines the numbers of the faults. Therefore the modules are imported in
the order of the catalogue.
"""

from handctl.safety.faults import bus, node, tendon, host  # noqa: F401, I001 - the order of the catalogue
