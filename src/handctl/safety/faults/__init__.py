"""Declarations of all faults.

The modules are imported in the order of the catalogue, because the order of the imports determines
the numbers of the faults.
"""

from handctl.safety.faults import bus, node, tendon, host  # noqa: F401, I001 - the order of the catalogue
