"""CAN buses with non-blocking calls. Each kind of bus has a module."""
