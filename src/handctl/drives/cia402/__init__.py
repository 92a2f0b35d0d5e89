"""CiA 402 drives in cyclic synchronous torque mode over CANopen."""
