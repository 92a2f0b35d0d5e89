"""CAN buses, read and written without blocking. Each kind of bus has a module in this package."""
