"""Writing of logs: the recorder process that writes the file, and the controller's end of the pipe to the recorder."""
