"""CAN buses with methods for reading and writing that never block.

Each kind of bus has its own module in this package.
"""
