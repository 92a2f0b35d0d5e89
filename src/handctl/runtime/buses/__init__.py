"""CAN buses with non-blocking calls, one module per kind of bus."""
