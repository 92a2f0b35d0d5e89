"""CiA 402 drives over CANopen, in the cyclic synchronous modes for torque, position and velocity."""
