"""The view room: logs and running hands in Rerun; the only room that imports it."""
