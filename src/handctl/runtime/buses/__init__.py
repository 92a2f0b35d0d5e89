"""CAN buses. No method that reads or writes a bus blocks.

Each kind of bus has its own module in this package.
"""
