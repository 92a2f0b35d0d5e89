"""A simulated CAN wire with frame times, arbitration, error counters and queues."""
