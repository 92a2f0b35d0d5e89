"""Writer of logs: the controller's end of the pipe, and the recorder process that owns the file."""
