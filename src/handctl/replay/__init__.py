"""What can be done with a recorded run: executed again, driven again, judged by other limits, compared."""
