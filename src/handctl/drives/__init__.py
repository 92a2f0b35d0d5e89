"""Motor drives and the sensor node: frames, codecs, and the state machine of each protocol."""
