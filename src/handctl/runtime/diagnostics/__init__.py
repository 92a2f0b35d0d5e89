"""Looking for what is wrong with a bus, an interface or a drive, without a controller."""
