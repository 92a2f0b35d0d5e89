"""Writing a log: the controller's end of the pipe, and the process that owns the file."""
