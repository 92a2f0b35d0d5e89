"""A simulated CAN wire on which frames take time, with arbitration, error counters and queues."""
