"""A CAN wire in virtual time: bit time, arbitration, queues, acknowledge, error states; sends and receives nothing."""
