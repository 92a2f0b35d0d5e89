"""A simulated CAN wire: frame times, arbitration, error counters and queues."""
