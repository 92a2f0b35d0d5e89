"""Writing of logs: the controller's end of the pipe, and the recorder process that writes the file."""
