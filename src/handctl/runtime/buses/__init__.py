"""CAN buses that never block, one module for each kind."""
