"""CANopen: identifiers, NMT, SDO transfers, and the set-up of a node by SDO."""
