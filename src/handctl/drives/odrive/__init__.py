"""ODrive motor drives with the protocol CANSimple, firmware 0.6.x and 0.5.x."""
