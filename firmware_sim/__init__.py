"""The far side of the wire: simulated drives, sensor node and plant of a tendon-driven hand."""
