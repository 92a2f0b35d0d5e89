"""CAN buses, read and written without blocking.

Each kind of bus has its own module in this package.
"""
